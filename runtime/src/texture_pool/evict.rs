//! What leaves the pools: oldest use first, the deepest first among equals.

use brickfell_shaders::layout::{BRICK, POINTER};

use super::{EMPTY_TILE, LATENCY, NONE, TexturePoolManager};

impl TexturePoolManager {
    /// Frees the slot of the brick not used for longest, if there is one that may leave.
    pub(super) fn evict_some_brick(&mut self, frame: u32) -> Option<u32> {
        if self.victims_frame != frame {
            self.victims_frame = frame;
            let (slots, tiles) = (&self.slots, &self.tiles);
            self.victims.clear();
            self.victims.extend((0..slots.len() as u32).filter(|s| {
                let slot = &slots[*s as usize];
                slot.node != NONE && slot.last_used + LATENCY < frame
            }));
            // Next victim last: oldest, and among those the deepest.
            self.victims.sort_unstable_by_key(|s| {
                let slot = &slots[*s as usize];
                (
                    std::cmp::Reverse(slot.last_used),
                    tiles[(slot.node >> 3) as usize].level,
                )
            });
        }
        while let Some(slot) = self.victims.pop() {
            let entry = self.slots[slot as usize];
            if entry.node != NONE && entry.last_used + LATENCY < frame {
                self.word(entry.node)[1] = 0;
                self.slots[slot as usize].node = NONE;
                return Some(slot);
            }
        }
        None
    }

    /// The same of a tile, with everything below it.
    pub(super) fn evict_some_tile(&mut self, frame: u32) -> Option<u32> {
        if self.tile_victims_frame != frame {
            self.tile_victims_frame = frame;
            let tiles = &self.tiles;
            self.tile_victims.clear();
            self.tile_victims
                .extend((1..tiles.len() as u32).filter(|t| tiles[*t as usize].is_old(frame)));
            self.tile_victims.sort_unstable_by_key(|t| {
                (
                    std::cmp::Reverse(tiles[*t as usize].last_used),
                    tiles[*t as usize].level,
                )
            });
        }
        while let Some(tile) = self.tile_victims.pop() {
            if self.tiles[tile as usize].is_old(frame) {
                self.remove_tile(tile);
                return self.free_tiles.pop();
            }
        }
        None
    }

    /// Takes a tile out, with everything below it.
    fn remove_tile(&mut self, tile: u32) {
        let entry = self.tiles[tile as usize];
        for [structure, data] in entry.words {
            let child = structure & POINTER;
            if child != 0 {
                self.remove_tile(child);
            }
            if structure & BRICK != 0 && data != 0 {
                self.slots[data as usize - 1].node = NONE;
                self.free_slots.push(data - 1);
            }
        }
        if entry.parent != NONE {
            self.word(entry.parent)[0] &= !POINTER;
        }
        self.tile_of.remove(&(entry.tree, entry.level, entry.index));
        self.tiles[tile as usize] = EMPTY_TILE;
        self.free_tiles.push(tile);
    }
}
