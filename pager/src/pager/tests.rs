//! The pager against a small terrain in memory, with faults.

mod ahead;
mod blocks;
mod budget;
mod faults;
mod order;
mod shutdown;
