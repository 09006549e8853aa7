//! A rendered picture in linear light, and the counters of the rays that drew it.

/// Linear-light, premultiplied RGBA; row 0 at the top.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Picture {
    /// Pixels per row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// `width * height` pixels.
    pub pixels: Vec<[f32; 4]>,
}

/// Sums over the rays of a picture.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RayCounters {
    /// Rays that met something (alpha above zero).
    pub rays_hit: u64,
    /// Node words read, over the rays that hit.
    pub nodes: u64,
    /// Positions at which bricks were read, over the rays that hit; both levels of a position count once.
    pub samples: u64,
    /// Trilinear reads, colour and normal each counting, over the rays that hit.
    pub texture_reads: u64,
    /// Rays stopped by the step cap.
    pub capped: u64,
    /// Pixels that came out NaN or infinite.
    pub not_finite: u64,
}

impl std::ops::Add for RayCounters {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        Self {
            rays_hit: self.rays_hit + other.rays_hit,
            nodes: self.nodes + other.nodes,
            samples: self.samples + other.samples,
            texture_reads: self.texture_reads + other.texture_reads,
            capped: self.capped + other.capped,
            not_finite: self.not_finite + other.not_finite,
        }
    }
}
