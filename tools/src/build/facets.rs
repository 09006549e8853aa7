//! What triangles leave in the cells of a tile, in the order in which they are met.
//!
//! Kept by block, and in a block only of cells that were met, since most are not. One thread's.

use super::cells::{BLOCK, Cells, Mask, NONE, count, dense, each, in_block, put};
use super::filter::Cover;
use super::lattice::{CellBox, SIDE};
use super::surface::Facet;

/// What triangles leave in a cell.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Facets {
    pub(super) skin: f32,
    pub(super) alpha: f32,
    pub(super) sum: f32,
    pub(super) rgb: [f32; 3],
    pub(super) normal: [f32; 3],
    pub(super) cover: Cover,
}

impl Facets {
    pub(super) fn add(&mut self, f: &Facet) {
        self.skin = self.skin.max(f.skin);
        self.alpha = self.alpha.max(f.alpha);
        self.sum += f.alpha;
        for k in 0..3 {
            self.rgb[k] += f.rgb[k] * f.alpha;
            self.normal[k] += f.normal[k] * f.alpha;
        }
    }
}

/// What faces leave in a block: numbers of cells, plus one, and what is in them as they were met first.
pub(super) struct FacetBlock {
    pub(super) at: [i64; 3],
    index: Box<[u16; BLOCK]>,
    facets: Vec<Facets>,
}

impl FacetBlock {
    #[inline]
    fn cell(&mut self, place: usize) -> &mut Facets {
        let number = &mut self.index[place];
        if *number == 0 {
            self.facets.push(Facets::default());
            *number = self.facets.len() as u16;
        }
        &mut self.facets[usize::from(*number) - 1]
    }

    pub(super) fn get(&self, place: usize) -> Option<&Facets> {
        let number = usize::from(self.index[place]).checked_sub(1)?;
        self.facets.get(number)
    }

    /// Cells for which something holds.
    pub(super) fn mask(&self, holds: impl Fn(&Facets) -> bool) -> Mask {
        let mut mask = NONE;
        for (place, number) in self.index.iter().enumerate().filter(|n| *n.1 > 0) {
            if holds(&self.facets[usize::from(*number) - 1]) {
                put(&mut mask, place);
            }
        }
        mask
    }

    /// What they cover, if anything.
    pub(super) fn covers(&self) -> Option<Cells<Cover>> {
        let held = self.mask(|f| f.cover != Cover::default());
        let mut covers = Vec::with_capacity(count(&held) as usize);
        each(&held, |place| covers.extend(self.get(place).map(|f| f.cover)));
        (held != NONE).then(|| Cells::new(held, NONE, covers))
    }
}

/// What faces leave in the blocks of a tile: blocks by their place, as they were met first.
pub(super) struct FacetBlocks {
    extent: CellBox,
    /// Number of a block, plus one; 0 where there is none.
    index: Vec<u32>,
    blocks: Vec<FacetBlock>,
}

impl FacetBlocks {
    pub(super) fn new(extent: &CellBox) -> Self {
        let size: i64 = (0..3).map(|k| extent.hi[k] - extent.lo[k]).product();
        Self {
            extent: *extent,
            index: vec![0; size as usize],
            blocks: Vec::new(),
        }
    }

    #[inline]
    pub(super) fn at(&mut self, [x, y, z]: [i64; 3]) -> &mut Facets {
        let at = [x.div_euclid(SIDE), y.div_euclid(SIDE), z.div_euclid(SIDE)];
        let CellBox { lo, hi } = &self.extent;
        let [i, j, k]: [i64; 3] = std::array::from_fn(|a| at[a] - lo[a]);
        let slot = &mut self.index[((k * (hi[1] - lo[1]) + j) * (hi[0] - lo[0]) + i) as usize];
        if *slot == 0 {
            self.blocks.push(FacetBlock {
                at,
                index: dense(),
                facets: Vec::new(),
            });
            *slot = self.blocks.len() as u32;
        }
        self.blocks[*slot as usize - 1].cell(in_block(x, y, z))
    }

    /// Blocks sorted by x, y, z.
    pub(super) fn sorted(mut self) -> Vec<FacetBlock> {
        self.blocks.sort_unstable_by_key(|b| b.at);
        self.blocks
    }
}
