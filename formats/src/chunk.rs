//! A chunk: the samples of the bricks in a cube of neighbouring bricks of one level, as one page.
//!
//! In memory a [`Chunk`] holds its bricks one after the other, apron included, ready for the GPU. On disk the bricks share
//! what they have in common: the payload is the box of samples that covers the present bricks (aprons at its outside
//! only, so it decodes without any other page). Packed, each sample is told by what is expected of it (module `pack`). Plain,
//! there is one plane of bytes per component, in columns from the top down, each byte as the difference to the one above it: bytes
//! that can be read by eye, and the oracle of tests. In blocks, bricks stand one after the other as the GPU reads them (module
//! [`crate::blocks`]), and samples are not what they were.

use std::ops::Range;

use glam::UVec3;

use crate::blocks::BlockChunk;
use crate::error::FormatError;
use crate::layout::{BRICK_VOXELS, SampleLayout};
use crate::morton;
use crate::occupancy::Occupancy;
use crate::pack::{self, Costs, Grid};

/// Largest chunk: 4³ bricks, one bit each in a 64-bit mask.
pub const MAX_CHUNK_SIDE: u32 = 4;

/// How payloads of a file are coded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Encoding {
    /// Column differences as they are.
    Plain = 0,
    /// By what is expected of each sample.
    Packed = 6,
    /// As blocks that the GPU reads; the only one with a loss.
    Blocks = 5,
}

impl Encoding {
    /// The encoding of a stored code, `None` where unknown.
    pub fn from_code(code: u8) -> Option<Self> {
        match code {
            0 => Some(Self::Plain),
            5 => Some(Self::Blocks),
            6 => Some(Self::Packed),
            _ => None,
        }
    }
}

/// What a file stores of each sample.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(u8)]
pub enum Layers {
    /// Colour and normal.
    #[default]
    Plain = 0b011,
    /// Colour, normal, and an opacity against each axis.
    Axes = 0b111,
}

impl Layers {
    /// The layers of a stored code, `None` where unknown.
    pub fn from_code(code: u8) -> Option<Self> {
        match code {
            0b011 => Some(Self::Plain),
            0b111 => Some(Self::Axes),
            _ => None,
        }
    }

    /// Components stored per sample: r, g, b, a, nx, ny, nz, and the opacities against x, y, z if there are any.
    fn planes(self) -> usize {
        match self {
            Self::Plain => 7,
            Self::Axes => PLANES,
        }
    }

    /// Bytes of a sample in memory.
    pub fn sample_bytes(self) -> usize {
        match self {
            Self::Plain => 8,
            Self::Axes => 12,
        }
    }
}

/// Bricks of a chunk in Morton order of their place in it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Chunk {
    /// Bit m is set if the brick at Morton code m inside the chunk is present.
    pub mask: u64,
    /// Samples per brick.
    pub layout: SampleLayout,
    /// Colours of all bricks; brick k at `k * layout.samples()`, x fastest.
    pub color: Vec<[u8; 4]>,
    /// Normals, in the same order.
    pub normal: Vec<[i8; 4]>,
    /// Opacities against x, y, z (see `value`) and a spare zero, in the same order; empty where the file has none.
    pub opacity: Vec<[u8; 4]>,
}

/// Most components of a sample.
const PLANES: usize = 10;

/// The box of samples that covers the present bricks.
struct Region {
    /// First brick of the box, in bricks from the chunk's corner.
    lo: UVec3,
    /// Samples per axis.
    size: UVec3,
}

impl Region {
    fn new(mask: u64, layout: SampleLayout) -> Self {
        let (mut lo, mut hi) = (UVec3::splat(MAX_CHUNK_SIDE), UVec3::ZERO);
        for p in brick_positions(mask) {
            lo = lo.min(p);
            hi = hi.max(p + 1);
        }
        let hi = hi.max(lo);
        Self {
            lo,
            size: (hi - lo) * BRICK_VOXELS + (layout.side() - BRICK_VOXELS),
        }
    }

    fn samples(&self) -> usize {
        (self.size.x * self.size.y * self.size.z) as usize
    }

    /// Calls with the index of each sample in the bricks and its place in the region: x, y, samples below the top.
    fn for_each_place(&self, mask: u64, layout: SampleLayout, mut call: impl FnMut(usize, [usize; 3])) {
        let side = layout.side();
        for (k, p) in brick_positions(mask).enumerate() {
            let first = k * layout.samples();
            let corner = (p - self.lo) * BRICK_VOXELS;
            let top = self.size.z - 1 - corner.z;
            for y in 0..side {
                for x in 0..side {
                    for z in 0..side {
                        let place = [corner.x + x, corner.y + y, top - z].map(|v| v as usize);
                        call(first + ((z * side + y) * side + x) as usize, place);
                    }
                }
            }
        }
    }

    /// Calls with the index of the topmost sample of each column of samples in the bricks and its place in the region.
    fn for_each_column(&self, mask: u64, layout: SampleLayout, mut call: impl FnMut(usize, [usize; 3])) {
        let side = layout.side();
        for (k, p) in brick_positions(mask).enumerate() {
            let corner = (p - self.lo) * BRICK_VOXELS;
            let top = self.size.z - side - corner.z;
            let first = (k + 1) * layout.samples() - (side * side) as usize;
            for (x, y) in (0..side).flat_map(|y| (0..side).map(move |x| (x, y))) {
                let place = [corner.x + x, corner.y + y, top].map(|v| v as usize);
                call(first + (y * side + x) as usize, place);
            }
        }
    }

    /// Says of a grid which samples bricks have.
    fn announce(&self, mask: u64, layout: SampleLayout, grid: &mut Grid) {
        self.for_each_column(mask, layout, |_, place| {
            grid.announce(grid.index(place), layout.side() as usize);
        });
    }

    /// The same as [`Self::for_each_place`] with the index of the place in a plane, where columns are the fastest axis; then x, then y.
    fn for_each_sample(&self, mask: u64, layout: SampleLayout, mut call: impl FnMut(usize, usize)) {
        let [columns, height] = [self.size.x as usize, self.size.z as usize];
        self.for_each_place(mask, layout, |sample, [x, y, down]| {
            call(sample, (y * columns + x) * height + down);
        });
    }
}

/// The samples of a chunk as a builder has them: in the box that covers its bricks, each once.
pub struct ChunkBox {
    mask: u64,
    layout: SampleLayout,
    region: Region,
    grid: Grid,
}

impl ChunkBox {
    /// The box of a mask of bricks (see [`Chunk::mask`]); nothing is in its samples. The looks that will be set are in steps by which none
    /// is off by more than `error`, 0 if they are not.
    pub fn new(mask: u64, layout: SampleLayout, layers: Layers, error: u8) -> Self {
        let region = Region::new(mask, layout);
        let mut grid = Grid::new(region.size, layers == Layers::Axes, error);
        region.announce(mask, layout, &mut grid);
        Self {
            mask,
            layout,
            region,
            grid,
        }
    }

    /// Which bricks there are.
    pub fn mask(&self) -> u64 {
        self.mask
    }

    /// The first brick of the box on each axis, in bricks from the chunk's corner. The first sample is that brick's first
    /// one, apron included.
    pub fn corner(&self) -> UVec3 {
        self.region.lo
    }

    /// Samples per axis.
    pub fn size(&self) -> UVec3 {
        self.region.size
    }

    /// Sets a sample by its place in the box, x, y, z from the low corner; nothing happens if no brick has it. What has been set
    /// may not be set again.
    #[inline]
    pub fn set(&mut self, [x, y, z]: [usize; 3], color: [u8; 4], normal: [i8; 4], opacity: [u8; 4]) {
        let top = self.region.size.z as usize - 1;
        self.grid
            .put(self.grid.index([x, y, top - z]), color, normal, opacity);
    }

    /// Sets samples above each other that are alike; `z` of the lowest, and of what is above the highest.
    #[inline]
    pub fn set_run(
        &mut self,
        [x, y]: [usize; 2],
        z: Range<usize>,
        color: [u8; 4],
        normal: [i8; 4],
        opacity: [u8; 4],
    ) {
        let top = self.grid.index([x, y, self.region.size.z as usize - z.end]);
        self.grid.put_run(top..top + z.len(), color, normal, opacity);
    }

    /// The bricks by themselves, each with its apron.
    fn chunk(&self) -> Chunk {
        let samples = self.mask.count_ones() as usize * self.layout.samples();
        let mut chunk = Chunk {
            mask: self.mask,
            layout: self.layout,
            color: vec![[0; 4]; samples],
            normal: vec![[0; 4]; samples],
            opacity: vec![[0; 4]; if self.grid.axes() { samples } else { 0 }],
        };
        self.region
            .for_each_place(self.mask, self.layout, |sample, place| {
                let (color, normal, opacity) = self.grid.get(self.grid.index(place));
                (chunk.color[sample], chunk.normal[sample]) = (color, normal);
                if let Some(slot) = chunk.opacity.get_mut(sample) {
                    *slot = opacity;
                }
            });
        chunk
    }

    /// Codes the chunk.
    pub fn encode(mut self, encoding: Encoding) -> Vec<u8> {
        match encoding {
            Encoding::Packed => pack::encode(&mut self.grid),
            Encoding::Blocks => BlockChunk::encode(&self.chunk()).into_bytes(),
            Encoding::Plain => {
                let layers = if self.grid.axes() {
                    Layers::Axes
                } else {
                    Layers::Plain
                };
                let n = self.region.samples();
                let mut planes = vec![0u8; n * layers.planes()];
                let [columns, height] = [self.region.size.x as usize, self.region.size.z as usize];
                self.region.for_each_place(self.mask, self.layout, |_, place| {
                    let (color, normal, opacity) = self.grid.get(self.grid.index(place));
                    let [x, y, down] = place;
                    let at = (y * columns + x) * height + down;
                    let planes = planes.iter_mut().skip(at).step_by(n);
                    planes
                        .zip(components(color, normal, opacity))
                        .for_each(|(plane, v)| *plane = v);
                });
                fold(&mut planes, height);
                planes
            }
        }
    }
}

/// The components of a sample in the order of planes.
fn components([r, g, b, a]: [u8; 4], [nx, ny, nz, _]: [i8; 4], [x, y, z, _]: [u8; 4]) -> [u8; PLANES] {
    [r, g, b, a, nx as u8, ny as u8, nz as u8, x, y, z]
}

/// Makes differences of columns, which are in turn from the top down.
fn fold(planes: &mut [u8], height: usize) {
    for column in planes.chunks_exact_mut(height) {
        let mut above = 0u8;
        for v in column {
            (*v, above) = (v.wrapping_sub(above), *v);
        }
    }
}

/// Places of the bricks of a mask, in bricks from the chunk's corner, in Morton order.
pub fn brick_positions(mask: u64) -> impl Iterator<Item = UVec3> {
    (0..64).filter(move |m| mask >> m & 1 == 1).map(morton::decode)
}

impl Chunk {
    /// Number of bricks.
    pub fn bricks(&self) -> usize {
        self.mask.count_ones() as usize
    }

    /// Colours of brick k.
    pub fn brick_color(&self, k: usize) -> &[[u8; 4]] {
        let n = self.layout.samples();
        &self.color[k * n..(k + 1) * n]
    }

    /// Normals of brick k.
    pub fn brick_normal(&self, k: usize) -> &[[i8; 4]] {
        let n = self.layout.samples();
        &self.normal[k * n..(k + 1) * n]
    }

    /// Opacities against the axes of brick k, if there are any.
    pub fn brick_opacity(&self, k: usize) -> Option<&[[u8; 4]]> {
        let n = self.layout.samples();
        self.opacity.get(k * n..(k + 1) * n)
    }

    /// Where brick k shows anything.
    pub fn occupancy(&self, k: usize) -> Occupancy {
        let color = self.brick_color(k);
        Occupancy::new(self.layout, |at| color[at][3] != 0)
    }

    /// What is stored of each sample.
    pub fn layers(&self) -> Layers {
        if self.opacity.is_empty() {
            Layers::Plain
        } else {
            Layers::Axes
        }
    }

    /// Changes colours and normals to those of looks in steps by which none is off by more than `error`, 0 to [`Steps::MOST`];
    /// what is stored of no look stays. A sample becomes what it does in any chunk.
    ///
    /// [`Steps::MOST`]: crate::steps::Steps::MOST
    pub fn in_steps(&mut self, error: u8) {
        for (color, normal) in self.color.iter_mut().zip(&mut self.normal) {
            (*color, *normal) = pack::in_steps(*color, *normal, error);
        }
    }

    /// Bytes the chunk takes in memory.
    pub fn memory(&self) -> usize {
        self.color.len() * self.layers().sample_bytes() + size_of::<Self>()
    }

    fn components(&self, sample: usize) -> [u8; PLANES] {
        let opacity = self.opacity.get(sample).copied().unwrap_or_default();
        components(self.color[sample], self.normal[sample], opacity)
    }

    /// Codes the chunk.
    ///
    /// # Errors
    /// If the number of samples does not match the mask, or bricks disagree about a sample that they share (but in blocks,
    /// where none is shared).
    pub fn encode(&self, encoding: Encoding) -> Result<Vec<u8>, FormatError> {
        self.encode_in_steps(encoding, 0)
    }

    /// The same of a chunk whose looks are in steps by which none is off by more than `error` ([`Self::in_steps`]), in fewer bytes.
    ///
    /// # Errors
    /// As [`Self::encode`].
    pub fn encode_in_steps(&self, encoding: Encoding, error: u8) -> Result<Vec<u8>, FormatError> {
        let samples = self.bricks() * self.layout.samples();
        let opacities = self.opacity.len();
        if self.color.len() != samples
            || self.normal.len() != samples
            || (opacities != 0 && opacities != samples)
        {
            return Err(FormatError::file("a chunk's samples do not match its mask"));
        }
        let region = Region::new(self.mask, self.layout);
        let payload = match encoding {
            Encoding::Plain => self.plain(&region),
            Encoding::Packed => self.grid(&region, error).map(|mut grid| pack::encode(&mut grid)),
            Encoding::Blocks => Some(BlockChunk::encode(self).into_bytes()),
        };
        payload.ok_or_else(|| {
            FormatError::file("neighbouring bricks of a chunk disagree about a sample that they share")
        })
    }

    /// The planes; `None` if bricks disagree.
    fn plain(&self, region: &Region) -> Option<Vec<u8>> {
        let n = region.samples();
        let count = self.layers().planes();
        let mut planes = vec![0u8; n * count];
        region.for_each_sample(self.mask, self.layout, |sample, place| {
            for (plane, v) in self.components(sample).into_iter().take(count).enumerate() {
                planes[plane * n + place] = v;
            }
        });
        let mut agree = true;
        region.for_each_sample(self.mask, self.layout, |sample, place| {
            for (plane, v) in self.components(sample).into_iter().take(count).enumerate() {
                agree &= planes[plane * n + place] == v;
            }
        });
        fold(&mut planes, region.size.z as usize);
        agree.then_some(planes)
    }

    /// What each part of the packed payload takes; `None` if the chunk cannot be coded.
    pub fn costs(&self) -> Option<Costs> {
        let samples = self.bricks() * self.layout.samples();
        if self.color.len() != samples || self.normal.len() != samples {
            return None;
        }
        self.grid(&Region::new(self.mask, self.layout), 0)
            .map(|mut grid| pack::costs(&mut grid))
    }

    /// The samples in their places; `None` if bricks disagree.
    fn grid(&self, region: &Region, error: u8) -> Option<Grid> {
        let mut grid = Grid::new(region.size, self.layers() == Layers::Axes, error);
        let mut agree = true;
        region.for_each_place(self.mask, self.layout, |sample, place| {
            let opacity = self.opacity.get(sample).copied().unwrap_or_default();
            let at = grid.index(place);
            agree &= grid.set(at, self.color[sample], self.normal[sample], opacity);
        });
        agree.then_some(grid)
    }

    /// Decodes a payload whose checksum has been verified.
    ///
    /// # Errors
    /// If the payload does not decode to exactly the samples that mask and layout ask for.
    pub fn decode(
        bytes: &[u8],
        mask: u64,
        layout: SampleLayout,
        layers: Layers,
        encoding: Encoding,
    ) -> Result<Self, FormatError> {
        let region = Region::new(mask, layout);
        let samples = mask.count_ones() as usize * layout.samples();
        let opacities = if layers == Layers::Axes { samples } else { 0 };
        let mut chunk = Self {
            mask,
            layout,
            color: vec![[0; 4]; samples],
            normal: vec![[0; 4]; samples],
            opacity: vec![[0; 4]; opacities],
        };
        match encoding {
            Encoding::Plain => chunk.unfold(bytes, &region, layers)?,
            Encoding::Packed => chunk.unpack(bytes, &region, layers)?,
            Encoding::Blocks => chunk = BlockChunk::new(bytes.to_vec(), mask, layout, layers)?.samples(),
        }
        Ok(chunk)
    }

    fn unfold(&mut self, bytes: &[u8], region: &Region, layers: Layers) -> Result<(), FormatError> {
        let n = region.samples();
        let count = layers.planes();
        if bytes.len() != n * count {
            return Err(FormatError::file(format!(
                "chunk payload has {} bytes, {} expected",
                bytes.len(),
                n * count
            )));
        }
        let mut planes = bytes.to_vec();
        for column in planes.chunks_exact_mut(region.size.z as usize) {
            let mut above = 0u8;
            for v in column {
                above = above.wrapping_add(*v);
                *v = above;
            }
        }
        region.for_each_sample(self.mask, self.layout, |sample, place| {
            let plane = |k: usize| planes[k * n + place];
            self.color[sample] = [0, 1, 2, 3].map(plane);
            let [x, y, z] = [4, 5, 6].map(|k| plane(k).cast_signed());
            self.normal[sample] = [x, y, z, 0];
            if layers == Layers::Axes {
                self.opacity[sample] = [plane(7), plane(8), plane(9), 0];
            }
        });
        Ok(())
    }

    fn unpack(&mut self, bytes: &[u8], region: &Region, layers: Layers) -> Result<(), FormatError> {
        let mut grid = Grid::new(region.size, layers == Layers::Axes, 0);
        region.announce(self.mask, self.layout, &mut grid);
        pack::decode(bytes, &mut grid)?;
        let side = self.layout.side() as usize;
        region.for_each_column(self.mask, self.layout, |top, place| {
            grid.each(grid.index(place), side, |down, (color, normal, opacity)| {
                let sample = top - down * side * side;
                self.color[sample] = color;
                self.normal[sample] = normal;
                if layers == Layers::Axes {
                    self.opacity[sample] = opacity;
                }
            });
        });
        Ok(())
    }
}
