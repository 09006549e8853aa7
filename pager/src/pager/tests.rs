//! The pager against a small terrain in memory, with faults.

mod budget;
mod faults;
mod order;
mod shutdown;
