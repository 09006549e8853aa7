//! The locks of the queue. The queue names them through its parent module, so that a test can compile it a second time
//! over the model checker's locks.

pub(crate) use std::sync::{Condvar, Mutex, MutexGuard};
