//! The pager against a small terrain in memory, with faults.

mod ahead;
mod budget;
mod faults;
mod order;
mod shutdown;
