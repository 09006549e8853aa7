//! A binary adaptive range coder: the way in which packed payloads turn decisions into bytes.
//!
//! A decision is coded with the probability that it is "no", which adapts to what has been coded so far. Encoder and decoder are
//! driven by the same code (see [`Coder`]), so they cannot disagree about what comes next. Integers only: the bytes are
//! the same on every machine. The carry-less form is that of G. N. N. Martin's range coder with the byte-wise carry
//! handling of LZMA; a probability is the mean of a fast and a slow estimate, as in VVC.

/// Bits of a probability.
const BITS: u32 = 15;
/// Certainty.
pub(super) const ONE: u32 = 1 << BITS;
/// The nearest to certainty that a probability comes.
const LEAST: u32 = 24;
/// Ranges below this are widened by a byte.
const LOW_RANGE: u32 = 1 << 24;
/// Bytes that a stream has at least.
const FLUSH: usize = 4;

/// What adapts: the probability of "no" in 1/65536, fast and slow, and how much has been seen.
#[derive(Clone, Copy, Debug)]
pub(super) struct Prob {
    fast: u16,
    slow: u16,
    seen: u8,
}

impl Default for Prob {
    fn default() -> Self {
        Self {
            fast: 1 << 15,
            slow: 1 << 15,
            seen: 0,
        }
    }
}

/// Steps of the estimates by what has been seen, in 1/65536: a mean of all at first, of the last few later.
const STEPS: usize = 64;
static FAST: [u16; STEPS] = steps(FAST_MEMORY);
static SLOW: [u16; STEPS] = steps(SLOW_MEMORY);
const FAST_MEMORY: u32 = 18;
const SLOW_MEMORY: u32 = 64;

const fn steps(memory: u32) -> [u16; STEPS] {
    let mut steps = [0; STEPS];
    let mut seen = 0;
    while seen < STEPS {
        let count = if (seen as u32) < memory {
            seen as u32
        } else {
            memory
        };
        steps[seen] = (65536 * 2 / (2 * count + 3)) as u16;
        seen += 1;
    }
    steps
}

/// The nearest probability that leaves room for the other decision.
#[inline]
pub(super) fn uncertain(no: u32) -> u32 {
    no.clamp(LEAST, ONE - LEAST)
}

impl Prob {
    /// The probability of "no", never certain.
    #[inline]
    pub(super) fn no(self) -> u32 {
        uncertain((u32::from(self.fast) + u32::from(self.slow)) >> (17 - BITS))
    }

    /// Moves towards a decision.
    #[inline]
    pub(super) fn learn(&mut self, yes: bool) {
        let seen = usize::from(self.seen);
        let step = |p: u16, rate: u16| {
            if yes {
                p - ((u32::from(p) * u32::from(rate)) >> 16) as u16
            } else {
                p + (((65535 - u32::from(p)) * u32::from(rate)) >> 16) as u16
            }
        };
        self.fast = step(self.fast, FAST[seen]);
        self.slow = step(self.slow, SLOW[seen]);
        self.seen = (self.seen + 1).min(STEPS as u8 - 1);
    }
}

/// Codes decisions one by one.
pub(super) trait Coder {
    /// Whether what is coded is known already.
    const ENCODES: bool;

    /// Codes a decision that is "no" with a probability of `no` in 1/[`ONE`]: an encoder writes `yes` and gives it back, a
    /// decoder gives what was written, whatever `yes` is.
    fn decide(&mut self, no: u32, yes: bool) -> bool;

    /// Whether more bytes than there are have been asked for.
    fn failed(&self) -> bool;

    /// Codes a decision by a probability that learns from it.
    #[inline]
    fn bit(&mut self, prob: &mut Prob, yes: bool) -> bool {
        let yes = self.decide(prob.no(), yes);
        prob.learn(yes);
        yes
    }
}

/// Writes decisions.
pub(super) struct Encoder {
    low: u64,
    range: u32,
    held: u8,
    pending: u64,
    bytes: Vec<u8>,
}

impl Encoder {
    pub(super) fn new() -> Self {
        Self {
            low: 0,
            range: u32::MAX,
            held: 0,
            pending: 1,
            bytes: Vec::new(),
        }
    }

    fn shift(&mut self) {
        if self.low < 0xff00_0000 || self.low > 0xffff_ffff {
            let carry = (self.low >> 32) as u8;
            self.bytes.push(self.held.wrapping_add(carry));
            for _ in 1..self.pending {
                self.bytes.push(0xffu8.wrapping_add(carry));
            }
            self.pending = 0;
            self.held = (self.low >> 24) as u8;
        }
        self.pending += 1;
        self.low = (self.low & 0x00ff_ffff) << 8;
    }

    /// The bytes of all decisions.
    pub(super) fn finish(mut self) -> Vec<u8> {
        for _ in 0..=FLUSH {
            self.shift();
        }
        // The byte before the first, which only a carry could have changed.
        self.bytes.remove(0);
        self.bytes
    }
}

impl Coder for Encoder {
    const ENCODES: bool = true;

    #[inline]
    fn failed(&self) -> bool {
        false
    }

    #[inline]
    fn decide(&mut self, no: u32, yes: bool) -> bool {
        let bound = (self.range >> BITS) * no;
        if yes {
            self.low += u64::from(bound);
            self.range -= bound;
        } else {
            self.range = bound;
        }
        while self.range < LOW_RANGE {
            self.range <<= 8;
            self.shift();
        }
        yes
    }
}

/// Reads decisions. Behind the end it reads zeros and remembers that it did.
pub(super) struct Decoder<'a> {
    bytes: &'a [u8],
    at: usize,
    range: u32,
    code: u32,
}

impl<'a> Decoder<'a> {
    pub(super) fn new(bytes: &'a [u8]) -> Self {
        let mut decoder = Self {
            bytes,
            at: 0,
            range: u32::MAX,
            code: 0,
        };
        for _ in 0..FLUSH {
            decoder.next();
        }
        decoder
    }

    #[inline]
    fn next(&mut self) {
        self.code = self.code << 8 | u32::from(self.bytes.get(self.at).copied().unwrap_or(0));
        self.at += 1;
    }

    /// Whether exactly all bytes have been asked for.
    pub(super) fn is_done(&self) -> bool {
        self.at == self.bytes.len()
    }
}

impl Coder for Decoder<'_> {
    const ENCODES: bool = false;

    #[inline]
    fn failed(&self) -> bool {
        self.at > self.bytes.len()
    }

    #[inline]
    fn decide(&mut self, no: u32, _: bool) -> bool {
        let bound = (self.range >> BITS) * no;
        let yes = self.code >= bound;
        if yes {
            self.code -= bound;
            self.range -= bound;
        } else {
            self.range = bound;
        }
        while self.range < LOW_RANGE {
            self.range <<= 8;
            self.next();
        }
        yes
    }
}

/// Differences in -128..=127: whether zero, sign, number of bits, bits.
#[derive(Clone, Debug, Default)]
pub(super) struct Residual {
    zero: Prob,
    negative: Prob,
    length: [Prob; 7],
    mantissa: [Prob; 32],
}

impl Residual {
    /// Codes the difference of a byte to what it was predicted to be; gives the difference.
    #[inline]
    pub(super) fn code(&mut self, coder: &mut impl Coder, value: i8) -> i8 {
        if !coder.bit(&mut self.zero, value != 0) {
            return 0;
        }
        let negative = coder.bit(&mut self.negative, value < 0);
        // Magnitudes less one: 0..127, so that -128 has seven bits, too.
        let magnitude = (if value < 0 { !value } else { value.wrapping_sub(1) }) as u8;
        let magnitude = magnitude.wrapping_add(1);
        let bits = u8::BITS - magnitude.leading_zeros();
        let mut length = 1u32;
        while length < 8 && coder.bit(&mut self.length[length as usize - 1], bits > length) {
            length += 1;
        }
        let mut known = 1usize;
        for place in (0..length - 1).rev() {
            // Beyond its first three bits a magnitude is noise.
            let index = if known < 16 { known } else { 16 + place as usize };
            known =
                known << 1 | usize::from(coder.bit(&mut self.mantissa[index], magnitude >> place & 1 == 1));
        }
        let magnitude = known.min(128) as u8 - 1;
        if negative {
            !(magnitude as i8)
        } else {
            (magnitude as i8).wrapping_add(1)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// Certain, impossible and even decisions in any order, so that carries run through many bytes.
        #[test]
        fn decisions_and_differences_round_trip(
            decisions in prop::collection::vec((0..=2u32, any::<bool>()), 0..4000),
            differences in prop::collection::vec(any::<i8>(), 0..300),
        ) {
            let no = |kind: u32| [LEAST, ONE / 2, ONE - LEAST][kind as usize];
            let mut encoder = Encoder::new();
            let (mut residual, mut prob) = (Residual::default(), Prob::default());
            for (kind, yes) in &decisions {
                encoder.decide(no(*kind), *yes);
                encoder.bit(&mut prob, *yes);
            }
            for v in &differences {
                residual.code(&mut encoder, *v);
            }
            let bytes = encoder.finish();
            let mut decoder = Decoder::new(&bytes);
            let (mut residual, mut prob) = (Residual::default(), Prob::default());
            for (kind, yes) in &decisions {
                prop_assert_eq!(decoder.decide(no(*kind), false), *yes);
                prop_assert_eq!(decoder.bit(&mut prob, false), *yes);
            }
            for v in &differences {
                prop_assert_eq!(residual.code(&mut decoder, 0), *v);
            }
            prop_assert!(decoder.is_done() && !decoder.failed());
        }
    }

    #[test]
    fn what_is_expected_costs_next_to_nothing() {
        let mut encoder = Encoder::new();
        let mut prob = Prob::default();
        for _ in 0..100_000 {
            encoder.bit(&mut prob, false);
        }
        let len = encoder.finish().len();
        assert!(len < 25, "{len}");
    }
}
