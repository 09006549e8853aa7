//! Where the samples of a brick lie, in one place so that the choice stays changeable.
//!
//! A brick covers 8×8×8 voxels. Interpolation inside it needs samples up to its faces, so it also stores an apron:
//!
//! ```text
//!  Corner (9³):  samples on voxel corners, sample i at i·v, the last one shared with the next brick
//!      |---+---+-- ... --+---|          0 .. 8
//!  Centre (10³): samples in voxel centres, sample i at (i+½)·v, one neighbour sample on each side
//!    . | . | . | .. ... | . | .        -1 .. 8
//! ```

/// Voxels of a brick per axis, apron not counted.
pub const BRICK_VOXELS: u32 = 8;

/// Where samples lie relative to voxels.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[repr(u8)]
pub enum SampleLayout {
    /// Samples on voxel corners, 9 per axis.
    Corner = 0,
    /// Samples in voxel centres with a border of one, 10 per axis.
    Centre = 1,
}

impl SampleLayout {
    /// The layout of a stored code, `None` where unknown.
    pub fn from_code(code: u8) -> Option<Self> {
        match code {
            0 => Some(Self::Corner),
            1 => Some(Self::Centre),
            _ => None,
        }
    }

    /// Samples of a brick per axis.
    pub const fn side(self) -> u32 {
        match self {
            Self::Corner => 9,
            Self::Centre => 10,
        }
    }

    /// Samples of a brick.
    pub const fn samples(self) -> usize {
        (self.side() * self.side() * self.side()) as usize
    }

    /// Samples stored below the brick's first own one, per axis.
    pub const fn low_apron(self) -> u32 {
        match self {
            Self::Corner => 0,
            Self::Centre => 1,
        }
    }

    /// Position of lattice sample `i` is `(i + offset)` voxels.
    pub const fn sample_offset(self) -> f64 {
        match self {
            Self::Corner => 0.0,
            Self::Centre => 0.5,
        }
    }

    /// What to add to a position in the brick (voxels from its low corner, 0..8) to get texel coordinates in the
    /// brick's block of a texture (where the centre of texel i is i + ½).
    pub const fn texel_offset(self) -> f64 {
        match self {
            Self::Corner => 0.5,
            Self::Centre => 1.0,
        }
    }

    /// Width of the rim, in voxels of the coarser level, inside which a constant node's parent may differ from it:
    /// parent samples that touch the outside reach that far into the node.
    pub const fn rim(self) -> f64 {
        match self {
            Self::Corner => 1.0,
            Self::Centre => 0.5,
        }
    }
}
