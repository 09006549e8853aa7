//! What the parts of a payload take: a coder that writes nothing and adds up.

use super::coder::{Coder, ONE};

/// What symbols tell.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Part {
    /// Which samples are empty, partial or solid.
    Classes,
    /// Whether looks are as expected.
    Same,
    /// Red of looks that are not.
    Red,
    /// Their green.
    Green,
    /// Their blue.
    Blue,
    /// The x of their normals.
    NormalX,
    /// The y of their normals.
    NormalY,
    /// The z of their normals.
    NormalZ,
    /// Opacities that are the same against all axes.
    Opacity,
    /// Whether they are.
    Equal,
    /// Opacities against x, where they are not.
    OpacityX,
    /// Against y.
    OpacityY,
    /// Against z.
    OpacityZ,
    /// How far alpha is from the largest of these.
    Largest,
    /// Whether solid looks as expected.
    Solid,
    /// Looks of solid that no surface is near.
    Deep,
    /// Bytes that are those of no look.
    Odd,
}

impl Part {
    /// All, in the order of their numbers.
    pub const ALL: [Self; 17] = [
        Self::Classes,
        Self::Same,
        Self::Red,
        Self::Green,
        Self::Blue,
        Self::NormalX,
        Self::NormalY,
        Self::NormalZ,
        Self::Opacity,
        Self::Equal,
        Self::OpacityX,
        Self::OpacityY,
        Self::OpacityZ,
        Self::Largest,
        Self::Solid,
        Self::Deep,
        Self::Odd,
    ];
}

/// What each part of a payload takes, by the part's number.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Costs {
    /// Bits, as symbols' expectations have them.
    pub bits: [f64; Part::ALL.len()],
    /// Symbols.
    pub symbols: [u64; Part::ALL.len()],
}

/// Adds up.
pub(super) struct Meter {
    pub(super) costs: Costs,
    part: Part,
}

impl Meter {
    pub(super) fn new() -> Self {
        Self {
            costs: Costs::default(),
            part: Part::Classes,
        }
    }
}

impl Coder for Meter {
    const ENCODES: bool = true;

    fn place(&self) -> u32 {
        0
    }

    fn take(&mut self, _: u32, length: u32) {
        let part = self.part as usize;
        self.costs.bits[part] += (f64::from(ONE) / f64::from(length)).log2();
        self.costs.symbols[part] += 1;
    }

    fn failed(&self) -> bool {
        false
    }

    fn part(&mut self, part: Part) {
        self.part = part;
    }
}
