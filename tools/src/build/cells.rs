//! What the cells of a block hold: masks of 8³ bits, and values for those cells that have one of their own.
//!
//! Most cells of a block that a surface passes through are empty or solid. Those cost a bit; what is left is kept in the
//! order of the cells, so that a level takes as much memory, and as much time to go through, as it has surface.

use super::lattice::{CellBox, SIDE};

/// Cells of a block.
pub(crate) const BLOCK: usize = (SIDE * SIDE * SIDE) as usize;

/// Cells of a layer of one height.
const LAYER: usize = (SIDE * SIDE) as usize;

/// A bit for each cell of a block: a word for each z, in it a byte for each y.
pub(crate) type Mask = [u64; SIDE as usize];

/// No cell.
pub(crate) const NONE: Mask = [0; SIDE as usize];

/// Index in a block of a cell given by its place on the lattice: x fastest.
#[inline]
pub(crate) fn in_block(x: i64, y: i64, z: i64) -> usize {
    let m = SIDE - 1;
    (((z & m) * SIDE + (y & m)) * SIDE + (x & m)) as usize
}

/// The part of a box of cells that lies in a block.
pub(crate) fn part(cells: &CellBox, block: [i64; 3]) -> CellBox {
    cells.intersection(&CellBox {
        lo: block.map(|b| b * SIDE),
        hi: block.map(|b| (b + 1) * SIDE),
    })
}

/// Bits of a range of cells along an axis of their block.
pub(crate) fn bits(lo: i64, hi: i64) -> u64 {
    let first = lo.rem_euclid(SIDE);
    ((1 << (hi - lo)) - 1) << first
}

/// The cells of a box that lie in a block.
pub(crate) fn mask_of(cells: &CellBox, block: [i64; 3]) -> Mask {
    let part = part(cells, block);
    let mut mask = NONE;
    if part.is_empty() {
        return mask;
    }
    let row = bits(part.lo[0], part.hi[0]);
    let plane = (part.lo[1]..part.hi[1]).fold(0, |plane, y| plane | row << (8 * y.rem_euclid(SIDE)));
    for z in part.lo[2]..part.hi[2] {
        mask[z.rem_euclid(SIDE) as usize] = plane;
    }
    mask
}

/// Cells of both masks.
#[inline]
pub(crate) fn both(a: &Mask, b: &Mask) -> Mask {
    std::array::from_fn(|z| a[z] & b[z])
}

/// Cells of the first mask that are not in the second.
#[inline]
pub(crate) fn without(a: &Mask, b: &Mask) -> Mask {
    std::array::from_fn(|z| a[z] & !b[z])
}

/// Cells of either mask.
#[inline]
pub(crate) fn either(a: &Mask, b: &Mask) -> Mask {
    std::array::from_fn(|z| a[z] | b[z])
}

/// Number of cells.
pub(crate) fn count(mask: &Mask) -> u32 {
    mask.iter().map(|word| word.count_ones()).sum()
}

/// Whether a mask has a cell.
#[inline]
pub(crate) fn has(mask: &Mask, place: usize) -> bool {
    mask[place / LAYER] >> (place % LAYER) & 1 == 1
}

/// Adds a cell.
#[inline]
pub(crate) fn put(mask: &mut Mask, place: usize) {
    mask[place / LAYER] |= 1 << (place % LAYER);
}

/// Calls with each column of a block that has cells, x and y in the block, and a bit for the z of each.
#[inline]
pub(crate) fn each_column(mask: &Mask, mut call: impl FnMut(usize, usize, u8)) {
    for y in 0..SIDE as usize {
        let mut rows = u64::from_le_bytes(mask.map(|layer| (layer >> (8 * y)) as u8));
        if rows == 0 {
            continue;
        }
        // Rows of x by z become rows of z by x: halves, quarters and eighths of the square change places.
        for (step, part) in [
            (28, 0x0000_0000_f0f0_f0f0),
            (14, 0x0000_cccc_0000_cccc),
            (7, 0x00aa_00aa_00aa_00aa),
        ] {
            let moved = (rows ^ rows >> step) & part;
            rows ^= moved ^ moved << step;
        }
        for (x, bits) in rows.to_le_bytes().into_iter().enumerate() {
            if bits != 0 {
                call(x, y, bits);
            }
        }
    }
}

/// Calls with the place of each cell of a mask, in their order.
#[inline]
pub(crate) fn each(mask: &Mask, mut call: impl FnMut(usize)) {
    for (z, word) in mask.iter().enumerate() {
        let mut left = *word;
        while left != 0 {
            call(z * LAYER + left.trailing_zeros() as usize);
            left &= left - 1;
        }
    }
}

/// A cell as it is found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Cell<T> {
    Empty,
    Solid,
    Held(T),
}

/// The cells of a block.
#[derive(Clone, Debug)]
pub(crate) struct Cells<T> {
    held: Mask,
    solid: Mask,
    /// Number of the first value of each layer.
    first: [u16; SIDE as usize],
    values: Vec<T>,
}

impl<T: Copy> Cells<T> {
    /// Cells with values in their order, and cells that are solid; no cell is both.
    pub(crate) fn new(held: Mask, solid: Mask, values: Vec<T>) -> Self {
        debug_assert_eq!(count(&held) as usize, values.len());
        debug_assert_eq!(both(&held, &solid), NONE);
        Self {
            held,
            solid,
            first: firsts(&held),
            values,
        }
    }

    /// Empty cells.
    pub(crate) fn nothing() -> Self {
        Self::new(NONE, NONE, Vec::new())
    }

    /// Cells that have a value.
    #[inline]
    pub(crate) fn held(&self) -> &Mask {
        &self.held
    }

    /// Cells that are solid.
    #[inline]
    pub(crate) fn solid(&self) -> &Mask {
        &self.solid
    }

    /// The values in the order of their cells.
    pub(crate) fn values(&self) -> &[T] {
        &self.values
    }

    /// Number of the value of a cell that has one.
    #[inline]
    fn rank(&self, place: usize) -> usize {
        let (z, bit) = (place / LAYER, place % LAYER);
        let before = self.held[z] & ((1 << bit) - 1);
        usize::from(self.first[z]) + before.count_ones() as usize
    }

    /// The value of a cell, if it has one.
    #[inline]
    pub(crate) fn value(&self, place: usize) -> Option<&T> {
        has(&self.held, place).then(|| &self.values[self.rank(place)])
    }

    /// What a cell is.
    pub(crate) fn get(&self, place: usize) -> Cell<T> {
        match self.value(place) {
            Some(value) => Cell::Held(*value),
            None if has(&self.solid, place) => Cell::Solid,
            None => Cell::Empty,
        }
    }

    /// Calls with the place and the value of each cell that has one.
    #[inline]
    pub(crate) fn each(&self, mut call: impl FnMut(usize, &T)) {
        let mut values = self.values.iter();
        each(&self.held, |place| {
            if let Some(value) = values.next() {
                call(place, value);
            }
        });
    }

    /// Makes a cell solid.
    pub(crate) fn make_solid(&mut self, place: usize) {
        if has(&self.held, place) {
            self.values.remove(self.rank(place));
            self.held[place / LAYER] &= !(1 << (place % LAYER));
            self.first = firsts(&self.held);
        }
        put(&mut self.solid, place);
    }

    /// Writes out all cells; `solid` is what those hold that are.
    pub(crate) fn spread(&self, solid: T, out: &mut [T; BLOCK])
    where
        T: Default,
    {
        out.fill(T::default());
        each(&self.solid, |place| out[place] = solid);
        self.each(|place, value| out[place] = *value);
    }
}

/// Number of the first value of each layer.
fn firsts(held: &Mask) -> [u16; SIDE as usize] {
    let mut sum = 0;
    held.map(|word| {
        let first = sum;
        sum += word.count_ones() as u16;
        first
    })
}

/// The cells of a block under construction, in any order. Kept to be used again.
#[derive(Debug)]
pub(crate) struct Draft<T> {
    held: Mask,
    solid: Mask,
    values: Box<[T; BLOCK]>,
}

impl<T: Copy + Default> Default for Draft<T> {
    fn default() -> Self {
        Self {
            held: NONE,
            solid: NONE,
            values: dense(),
        }
    }
}

impl<T: Copy + Default> Draft<T> {
    /// Gives a cell a value.
    #[inline]
    pub(crate) fn put(&mut self, place: usize, value: T) {
        put(&mut self.held, place);
        self.values[place] = value;
    }

    /// Makes a cell solid that has no value.
    #[inline]
    pub(crate) fn make_solid(&mut self, place: usize) {
        put(&mut self.solid, place);
    }

    /// Takes over the cells of some layers.
    pub(crate) fn put_layers(&mut self, layers: std::ops::Range<usize>, from: &Cells<T>) {
        let mut mask = NONE;
        mask[layers].fill(u64::MAX);
        self.held = without(&self.held, &mask);
        self.solid = either(&without(&self.solid, &mask), &both(from.solid(), &mask));
        from.each(|place, value| {
            if has(&mask, place) {
                self.put(place, *value);
            }
        });
    }

    /// Whether all cells are solid.
    pub(crate) fn is_solid(&self) -> bool {
        self.solid == [u64::MAX; SIDE as usize]
    }

    /// What has been put, if anything; the draft is empty again.
    pub(crate) fn take(&mut self) -> Option<Cells<T>> {
        let (held, solid) = (self.held, self.solid);
        (self.held, self.solid) = (NONE, NONE);
        if held == NONE && solid == NONE {
            return None;
        }
        let mut values = Vec::with_capacity(count(&held) as usize);
        each(&held, |place| values.push(self.values[place]));
        Some(Cells::new(held, solid, values))
    }
}

/// A value for each cell of a block, made in place.
pub(crate) fn dense<T: Copy + Default>() -> Box<[T; BLOCK]> {
    match vec![T::default(); BLOCK].into_boxed_slice().try_into() {
        Ok(dense) => dense,
        Err(_) => Box::new([T::default(); BLOCK]),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn kinds() -> impl Strategy<Value = Vec<u8>> {
        prop::collection::vec(prop_oneof![Just(0u8), Just(1), 2..=255u8], BLOCK)
    }

    /// 0 is empty, 1 solid.
    fn cells(kinds: &[u8]) -> Option<Cells<u8>> {
        let mut draft = Draft::default();
        for (place, kind) in kinds.iter().enumerate() {
            match kind {
                0 => {}
                1 => draft.make_solid(place),
                value => draft.put(place, *value),
            }
        }
        draft.take()
    }

    fn kind(cell: Cell<u8>) -> u8 {
        match cell {
            Cell::Empty => 0,
            Cell::Solid => 1,
            Cell::Held(value) => value,
        }
    }

    proptest! {
        #[test]
        fn cells_hold_what_was_put(kinds in kinds(), other in kinds(), solid in 0..BLOCK, layers in 0..8usize) {
            let mut cells = cells(&kinds).unwrap();
            let mut spread = [0; BLOCK];
            cells.spread(1, &mut spread);
            prop_assert_eq!(&spread[..], &kinds[..]);
            prop_assert!((0..BLOCK).all(|place| kind(cells.get(place)) == kinds[place]));
            let mut draft = Draft::default();
            draft.put_layers(0..8, &cells);
            let other_cells = super::tests::cells(&other).unwrap();
            draft.put_layers(layers..8, &other_cells);
            draft.take().unwrap().spread(1, &mut spread);
            let cut = 64 * layers;
            prop_assert!(spread[..cut] == kinds[..cut] && spread[cut..] == other[cut..]);
            cells.make_solid(solid);
            let mut by_column = NONE;
            each_column(cells.held(), |x, y, bits| {
                (0..8).filter(|z| bits >> z & 1 == 1).for_each(|z| put(&mut by_column, z * 64 + y * 8 + x));
            });
            prop_assert_eq!(&by_column, cells.held());
            let mut expected = kinds;
            expected[solid] = 1;
            prop_assert!((0..BLOCK).all(|place| kind(cells.get(place)) == expected[place]));
        }
    }

    #[test]
    fn masks_of_boxes() {
        let cells = CellBox {
            lo: [-9, -3, 6],
            hi: [-1, 2, 20],
        };
        let mask = mask_of(&cells, [-1, -1, 0]);
        let mut found = Vec::new();
        each(&mask, |place| found.push(place));
        let expected: Vec<usize> = (0..BLOCK)
            .filter(|k| k % 8 < 7 && k / 8 % 8 >= 5 && k / 64 >= 6)
            .collect();
        assert_eq!(found, expected);
        assert_eq!(count(&mask) as usize, found.len());
        assert_eq!(mask_of(&cells, [0, 0, 0]), NONE);
        assert_eq!(in_block(-1, -8, 9), 7 + 64);
    }

    #[test]
    fn an_empty_draft_has_no_cells() {
        assert!(Draft::<u8>::default().take().is_none());
    }
}
