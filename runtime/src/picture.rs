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

impl Picture {
    /// The picture at another size, interpolated between the centres of its pixels and going on with its edges; the same
    /// bits at the same size. For enlarging: pixels between are not averaged.
    pub fn resized(self, width: u32, height: u32) -> Self {
        if (width, height) == (self.width, self.height) || self.pixels.is_empty() {
            return self;
        }
        // The two pixels around each new one, and the part of the second.
        let axis = |new: u32, old: u32| -> Vec<(usize, usize, f32)> {
            let ratio = f64::from(old) / f64::from(new);
            let last = f64::from(old - 1);
            let at = |k| ((f64::from(k) + 0.5) * ratio - 0.5).clamp(0.0, last);
            (0..new)
                .map(|k| {
                    (
                        at(k).floor() as usize,
                        at(k).ceil() as usize,
                        at(k).fract() as f32,
                    )
                })
                .collect()
        };
        let columns = axis(width, self.width);
        let mix = |a: [f32; 4], b: [f32; 4], t: f32| std::array::from_fn(|c| a[c] + (b[c] - a[c]) * t);
        let row = |y: usize| &self.pixels[y * self.width as usize..][..self.width as usize];
        let pixels = axis(height, self.height).into_iter().flat_map(|(y0, y1, v)| {
            let (above, below) = (row(y0), row(y1));
            (columns.iter())
                .map(move |&(x0, x1, u)| mix(mix(above[x0], above[x1], u), mix(below[x0], below[x1], u), v))
        });
        Self {
            width,
            height,
            pixels: pixels.collect(),
        }
    }
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_ramp_stays_a_ramp_and_edges_go_on() {
        let pixels = (0..6).map(|k| [(k % 3) as f32, (k / 3) as f32, 0.5, 1.0]);
        let small = Picture {
            width: 3,
            height: 2,
            pixels: pixels.collect(),
        };
        assert_eq!(small.clone().resized(3, 2), small);
        let large = small.resized(6, 4);
        assert_eq!((large.width, large.height, large.pixels.len()), (6, 4, 24));
        let xs: Vec<f32> = large.pixels[..6].iter().map(|p| p[0]).collect();
        let ys: Vec<f32> = large.pixels.iter().step_by(6).map(|p| p[1]).collect();
        assert_eq!(xs, [0.0, 0.25, 0.75, 1.25, 1.75, 2.0]);
        assert_eq!(ys, [0.0, 0.25, 0.75, 1.0]);
        assert!(large.pixels.iter().all(|p| p[2..] == [0.5, 1.0]));
        assert_eq!(Picture::default().resized(2, 2), Picture::default());
    }
}
