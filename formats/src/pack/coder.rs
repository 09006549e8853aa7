//! An adaptive entropy coder: the way in which packed payloads turn symbols into bytes.
//!
//! A symbol is one of sixteen and is coded by how often it is expected, which adapts to what has been coded so far. Encoder and
//! decoder are driven by the same code (see [`Coder`]), so they cannot disagree about what comes next. Integers only: the
//! bytes are the same on every machine. The coder is a range variant of asymmetric numeral systems (J. Duda 2013, "Asymmetric
//! numeral systems") with two states in turn, so that two symbols are under way at once (F. Giesen 2014, "Interleaved
//! entropy coders"); expectations are cumulative counts that move a part of the way towards what came.

use super::meter::Part;

/// Bits of an expectation.
const BITS: u32 = 15;
/// Certainty.
pub(super) const ONE: u32 = 1 << BITS;
/// Symbols of an alphabet.
pub(super) const SYMBOLS: usize = 16;
/// States are at least this, and below it times 2^16.
const LEAST_STATE: u32 = 1 << 16;
/// Bytes of the two states, which a stream begins with.
pub(super) const STATES: usize = 8;

/// What is expected of a symbol: for each, how much the smaller ones have of [`ONE`]. Strictly increasing from 0.
pub(super) type Odds = [i16; SYMBOLS];

/// Odds that adapt.
#[derive(Clone, Copy, Debug)]
pub(super) struct Model {
    odds: Odds,
    seen: u8,
}

/// What odds move to by the symbol that came: all to it but one for each other.
static GOALS: [Odds; SYMBOLS] = {
    let mut goals = [[0; SYMBOLS]; SYMBOLS];
    let mut symbol = 0;
    while symbol < SYMBOLS {
        let mut k = 0;
        while k < SYMBOLS {
            goals[symbol][k] = if k > symbol {
                (ONE as usize - SYMBOLS + k) as i16
            } else {
                k as i16
            };
            k += 1;
        }
        symbol += 1;
    }
    goals
};

/// By how much has been seen, the part of the way: 1 / 2^this.
static RATES: [u8; 32] = {
    let mut rates = [5; 32];
    let mut k = 0;
    while k < 30 {
        rates[k] = if k < 4 {
            2
        } else if k < 12 {
            3
        } else {
            4
        };
        k += 1;
    }
    rates
};

impl Default for Model {
    fn default() -> Self {
        Self {
            odds: std::array::from_fn(|k| (k as u32 * ONE / SYMBOLS as u32) as i16),
            seen: 0,
        }
    }
}

impl Model {
    #[inline]
    fn learn(&mut self, symbol: usize) {
        let rate = u32::from(RATES[usize::from(self.seen)]);
        let goal = &GOALS[symbol % SYMBOLS];
        for (odds, goal) in self.odds.iter_mut().zip(goal) {
            *odds += (*goal - *odds) >> rate;
        }
        self.seen = (self.seen + 1).min(RATES.len() as u8 - 1);
    }
}

/// A decision that adapts: the expectation of "no".
#[derive(Clone, Copy, Debug)]
pub(super) struct Prob {
    fast: u16,
    slow: u16,
    seen: u8,
}

impl Default for Prob {
    fn default() -> Self {
        Self {
            fast: 1 << 14,
            slow: 1 << 14,
            seen: 0,
        }
    }
}

/// The nearest to certainty that an expectation comes.
const LEAST: u32 = 24;

impl Prob {
    #[inline]
    fn no(self) -> u32 {
        ((u32::from(self.fast) + u32::from(self.slow)) / 2).clamp(LEAST, ONE - LEAST)
    }

    #[inline]
    fn learn(&mut self, yes: bool) {
        let step = |p: u16, rate: u8| {
            if yes {
                p - (p >> rate)
            } else {
                p + ((ONE as u16 - p) >> rate)
            }
        };
        let seen = self.seen;
        let rate = 1 + (seen > 1) as u8 + (seen > 4) as u8 + (seen > 12) as u8;
        self.fast = step(self.fast, rate);
        self.slow = step(self.slow, rate + (seen > 24) as u8 + (seen > 50) as u8);
        self.seen = seen.saturating_add(1);
    }
}

/// Codes symbols one by one.
pub(super) trait Coder {
    /// Whether what is coded is known already.
    const ENCODES: bool;

    /// Where in 0..[`ONE`] the next symbol is; an encoder does not know.
    fn place(&self) -> u32;

    /// Codes the symbol that has these places.
    fn take(&mut self, start: u32, length: u32);

    /// Whether more bytes than there are have been asked for.
    fn failed(&self) -> bool;

    /// What the symbols that follow tell; only a meter cares.
    #[inline]
    fn part(&mut self, _: Part) {}

    /// Codes a decision by what is expected of it.
    #[inline]
    fn bit(&mut self, prob: &mut Prob, yes: bool) -> bool {
        let no = prob.no();
        let yes = if Self::ENCODES { yes } else { self.place() >= no };
        if yes {
            self.take(no, ONE - no);
        } else {
            self.take(0, no);
        }
        prob.learn(yes);
        yes
    }

    /// Codes up to 15 bits of which nothing is expected.
    #[inline]
    fn bits(&mut self, count: u32, bits: u32) -> u32 {
        let shift = BITS - count;
        let bits = if Self::ENCODES {
            bits
        } else {
            self.place() >> shift
        };
        self.take(bits << shift, 1 << shift);
        bits
    }

    /// Codes a symbol by the mean of what models expect, which learn from it: an encoder writes `symbol` and gives it back, a decoder
    /// gives what was written, whatever it is.
    #[inline]
    fn by<const N: usize>(&mut self, models: [&mut Model; N], symbol: usize) -> usize {
        let symbol = if Self::ENCODES {
            // Only the symbol's own place is asked for.
            let symbol = symbol % SYMBOLS;
            let [start, end] = [symbol, symbol + 1].map(|k| mean_at(&models, k));
            self.take(start, end - start);
            symbol
        } else {
            let odds = mean(&models);
            let place = self.place() as i16;
            let below: i16 = odds.iter().map(|o| i16::from(*o <= place)).sum();
            let symbol = (below - 1) as usize % SYMBOLS;
            let start = odds[symbol] as u32;
            let end = odds.get(symbol + 1).map_or(ONE, |o| *o as u32);
            self.take(start, end - start);
            symbol
        };
        for model in models {
            model.learn(symbol);
        }
        symbol
    }
}

/// Quarters that models have of their mean.
const fn shares<const N: usize>() -> [u16; N] {
    let mut shares = [4 / N as u16; N];
    shares[0] += 4 % N as u16;
    shares
}

/// The mean of what models expect.
#[inline]
fn mean<const N: usize>(models: &[&mut Model; N]) -> Odds {
    if N == 1 {
        return models[0].odds;
    }
    // Below 2^15 each and four in all: a sum of quarters would not fit.
    let (mut sums, mut rest) = ([0u16; SYMBOLS], [0u16; SYMBOLS]);
    for (model, share) in models.iter().zip(shares::<N>()) {
        for k in 0..SYMBOLS {
            sums[k] += (model.odds[k] as u16 >> 2) * share;
            rest[k] += (model.odds[k] as u16 & 3) * share;
        }
    }
    std::array::from_fn(|k| (sums[k] + (rest[k] >> 2)) as i16)
}

/// One place of that.
#[inline]
fn mean_at<const N: usize>(models: &[&mut Model; N], k: usize) -> u32 {
    if k == SYMBOLS {
        return ONE;
    }
    let odds = models.iter().zip(shares::<N>());
    odds.map(|(model, share)| model.odds[k] as u32 * u32::from(share))
        .sum::<u32>()
        >> 2
}

/// Writes symbols: keeps their places, since the coder works from the last to the first.
pub(super) struct Encoder {
    taken: Vec<[u16; 2]>,
}

impl Encoder {
    pub(super) fn new() -> Self {
        Self { taken: Vec::new() }
    }

    /// The bytes of all symbols.
    pub(super) fn finish(self) -> Vec<u8> {
        let mut words = Vec::with_capacity(self.taken.len() / 4);
        let mut states = [LEAST_STATE; 2];
        for (k, [start, length]) in self.taken.iter().enumerate().rev() {
            let state = &mut states[k % 2];
            let (start, length) = (u32::from(*start), u32::from(*length));
            if *state >> (32 - BITS) >= length {
                words.push(*state as u16);
                *state >>= 16;
            }
            *state = (*state / length) << BITS | (*state % length + start);
        }
        let states = states.iter().flat_map(|s| s.to_le_bytes());
        let words = words.iter().rev().flat_map(|w| w.to_le_bytes());
        states.chain(words).collect()
    }
}

impl Coder for Encoder {
    const ENCODES: bool = true;

    #[inline]
    fn place(&self) -> u32 {
        0
    }

    #[inline]
    fn take(&mut self, start: u32, length: u32) {
        self.taken.push([start as u16, length as u16]);
    }

    #[inline]
    fn failed(&self) -> bool {
        false
    }
}

/// Reads symbols. Behind the end it reads zeros and remembers that it did.
pub(super) struct Decoder<'a> {
    words: &'a [[u8; 2]],
    odd: bool,
    at: usize,
    states: [u32; 2],
}

impl<'a> Decoder<'a> {
    pub(super) fn new(bytes: &'a [u8]) -> Self {
        let (words, odd) = bytes.as_chunks();
        let half = |k: usize| u32::from(u16::from_le_bytes(words.get(k).copied().unwrap_or_default()));
        Self {
            words,
            odd: !odd.is_empty(),
            at: STATES / 2,
            states: [half(0) | half(1) << 16, half(2) | half(3) << 16],
        }
    }

    /// Whether exactly all bytes have been asked for, and the states are those that an encoder begins with.
    pub(super) fn is_done(&self) -> bool {
        self.is_done_but_for_zeros() && self.at == self.words.len()
    }

    /// Whether the bytes that have not been asked for are zeros, and the states are those that an encoder begins with.
    pub(super) fn is_done_but_for_zeros(&self) -> bool {
        let rest = self.words.get(self.at..);
        let zeros = rest.is_some_and(|words| words.iter().all(|word| *word == [0; 2]));
        !self.odd && zeros && self.states == [LEAST_STATE; 2]
    }
}

impl Coder for Decoder<'_> {
    const ENCODES: bool = false;

    #[inline]
    fn place(&self) -> u32 {
        self.states[0] & (ONE - 1)
    }

    #[inline]
    fn take(&mut self, start: u32, length: u32) {
        // Wraps only where the bytes are not those of an encoder.
        let [state, next] = self.states;
        let mut state = length
            .wrapping_mul(state >> BITS)
            .wrapping_add((state & (ONE - 1)).wrapping_sub(start));
        if state < LEAST_STATE {
            let word = self.words.get(self.at).copied().unwrap_or_default();
            state = state << 16 | u32::from(u16::from_le_bytes(word));
            self.at += 1;
        }
        self.states = [next, state];
    }

    #[inline]
    fn failed(&self) -> bool {
        self.at > self.words.len()
    }
}

/// Differences in -128..=127: small ones are symbols, from the least on; larger ones say how many bits follow.
#[inline]
pub(super) fn residual<const N: usize>(coder: &mut impl Coder, models: [&mut Model; N], value: i8) -> i8 {
    let folded = u32::from((value << 1 ^ value >> 7).cast_unsigned());
    let symbol = match folded {
        0..13 => folded,
        13..29 => 13,
        29..93 => 14,
        _ => 15,
    };
    let symbol = coder.by(models, symbol as usize);
    let mut more = |first: u32, bits: u32| first + coder.bits(bits, folded.wrapping_sub(first) & 0xff);
    let folded = match symbol {
        13 => more(13, 4),
        14 => more(29, 6),
        15 => more(93, 8),
        small => small as u32,
    } as u8;
    (folded >> 1 ^ (folded & 1).wrapping_neg()).cast_signed()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// The same calls for both directions.
    fn run<C: Coder>(
        coder: &mut C,
        decisions: &[bool],
        symbols: &[u8],
        differences: &[i8],
    ) -> (Vec<bool>, Vec<u8>, Vec<i8>) {
        let known = C::ENCODES;
        let (mut prob, mut models) = (Prob::default(), [Model::default(); 4]);
        let decide = |v: &bool| coder.bit(&mut prob, known && *v);
        let decisions = decisions.iter().map(decide).collect();
        let symbols = symbols.iter().map(|v| {
            let [a, b, c, d] = models.each_mut();
            let more = coder.bits(4, if known { u32::from(*v >> 4) } else { 0 }) as u8;
            let v = if known { usize::from(*v & 15) } else { 0 };
            more << 4
                | match more % 3 {
                    0 => coder.by([a], v),
                    1 => coder.by([a, b, c], v),
                    _ => coder.by([d, c, b, a], v),
                } as u8
        });
        let symbols = symbols.collect();
        let [_, b, _, d] = &mut models;
        let code = |v: &i8| residual(coder, [&mut *d, &mut *b], if known { *v } else { 0 });
        (decisions, symbols, differences.iter().map(code).collect())
    }

    proptest! {
        #[test]
        fn all_kinds_of_symbols_round_trip(
            decisions in prop::collection::vec(any::<bool>(), 0..2000),
            symbols in prop::collection::vec(any::<u8>(), 0..2000),
            differences in prop::collection::vec(any::<i8>(), 0..600),
        ) {
            let mut encoder = Encoder::new();
            run(&mut encoder, &decisions, &symbols, &differences);
            let bytes = encoder.finish();
            let mut decoder = Decoder::new(&bytes);
            let got = run(&mut decoder, &decisions, &symbols, &differences);
            prop_assert_eq!(got, (decisions, symbols, differences));
            prop_assert!(decoder.is_done() && !decoder.failed());
        }
    }

    #[test]
    fn what_is_expected_costs_next_to_nothing() {
        let mut encoder = Encoder::new();
        let (mut prob, mut model) = (Prob::default(), Model::default());
        for _ in 0..10_000 {
            encoder.bit(&mut prob, false);
            encoder.by([&mut model], 3);
        }
        let len = encoder.finish().len();
        assert!(len < 40, "{len}");
    }

    /// However long a symbol has been away, it can be coded.
    #[test]
    fn odds_increase_strictly() {
        for symbol in 0..SYMBOLS {
            let mut model = Model::default();
            for _ in 0..10_000 {
                model.learn(symbol);
            }
            let ends = model
                .odds
                .iter()
                .skip(1)
                .map(|o| i32::from(*o))
                .chain([ONE as i32]);
            assert!(model.odds[0] == 0 && model.odds.iter().zip(ends).all(|(a, b)| i32::from(*a) < b));
        }
    }
}
