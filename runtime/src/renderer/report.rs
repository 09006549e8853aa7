//! What a frame tells of itself. Plain value: any thread.

/// What a frame did. Times in milliseconds.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FrameReport {
    /// Number of the frame, from 1.
    pub frame: u32,
    /// Trees in view, where groups are far coarse ones instead of what is inside.
    pub trees_visible: usize,
    /// Of those, trees that were drawn.
    pub trees_active: usize,
    /// Trees in view, or to be drawn instead of others in view, whose roots are still on the way.
    pub trees_waiting: usize,
    /// Bricks in the pool.
    pub bricks_resident: u32,
    /// Of those, bricks that the newest rays read back used, those above them, and what came for them since.
    pub bricks_in_use: u32,
    /// Bricks uploaded.
    pub uploads: usize,
    /// Node words uploaded.
    pub node_updates: usize,
    /// Bytes uploaded.
    pub bytes_uploaded: u64,
    /// Pages and bricks asked for that are not there yet.
    pub pending: usize,
    /// Bias in effect, the user's and the controllers'.
    pub bias: f64,
    /// Part of the pixels per axis that were drawn.
    pub scale: f64,
    /// Publishing finished loads.
    pub merge_ms: f64,
    /// Culling and ordering.
    pub cull_ms: f64,
    /// Making resident, staging uploads.
    pub upload_ms: f64,
    /// Taking read-backs.
    pub readback_ms: f64,
    /// Encoding and submitting.
    pub submit_ms: f64,
    /// The whole call.
    pub cpu_ms: f64,
    /// From the begin of the call to the device's end; known when settling, where it is waited for.
    pub frame_ms: f64,
}
