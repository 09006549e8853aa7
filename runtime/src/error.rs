//! What can go wrong between a database and a picture.

use brickfell_pager::PageFault;

/// Errors of the runtime.
#[derive(Debug, thiserror::Error)]
pub enum RuntimeError {
    /// No GPU or software device to draw with.
    #[error("no Vulkan, Metal or DirectX 12 adapter was found")]
    NoAdapter,
    /// The adapter refused the device.
    #[error("the adapter {adapter} gives no device: {reason}")]
    NoDevice {
        /// Name of the adapter.
        adapter: String,
        /// What it said.
        reason: String,
    },
    /// The device was lost or reported an error.
    #[error("the GPU device failed: {0}")]
    Device(String),
    /// The pools do not fit.
    #[error("a GPU budget of {budget} bytes is too small: {reason}")]
    Budget {
        /// The budget.
        budget: u64,
        /// What does not fit.
        reason: String,
    },
    /// Camera or settings that no picture can be made of.
    #[error("{0}")]
    Argument(&'static str),
    /// A picture that cannot be drawn.
    #[error("a picture of {width}×{height} pixels cannot be drawn: {reason}")]
    Size {
        /// Pixels per row.
        width: u32,
        /// Rows.
        height: u32,
        /// Why.
        reason: String,
    },
    /// A picture did not settle.
    #[error("the picture did not settle in {frames} frames: {pending} pages are still missing")]
    NotSettled {
        /// Frames tried.
        frames: u32,
        /// Pages asked for and not there.
        pending: usize,
    },
    /// The scene has no tree that can be drawn.
    #[error("no tree can be read: {}", .0.first().map_or("the scene is empty", |f| f.message.as_str()))]
    NoTree(Vec<PageFault>),
}
