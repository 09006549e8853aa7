//! Bytes by several contexts at once, for what has no order that a difference would follow.
//!
//! A byte is coded from its highest bit down. Each context expects something of the next bit; the log odds of what they expect are
//! added up with weights, which follow the contexts that were right (logistic mixing, after M. Mahoney 2005, "Adaptive
//! weighing of context models for lossless data compression").

use std::sync::LazyLock;

use super::coder::{Coder, ONE, Prob, uncertain};

/// Largest log odds; they have eight bits behind the point.
const MOST: i32 = 2047;
/// Steps between probabilities whose log odds are told apart.
const STEP: u32 = ONE / 4096;
/// A weight of one.
const UNIT: i32 = 1 << 16;
/// How slowly weights follow.
const SLOWNESS: u32 = 13;

struct Tables {
    odds: Vec<i32>,
    no: Vec<u32>,
}

static TABLES: LazyLock<Tables> = LazyLock::new(|| {
    let log_odds = |k: u32| {
        let p = (f64::from(k) + 0.5) * f64::from(STEP) / f64::from(ONE);
        ((p / (1.0 - p)).ln() * 256.0).round() as i32
    };
    let no = |odds: i32| f64::from(ONE) / (1.0 + (-f64::from(odds) / 256.0).exp());
    Tables {
        odds: (0..ONE / STEP).map(|k| log_odds(k).clamp(-MOST, MOST)).collect(),
        no: (-MOST..=MOST)
            .map(|odds| uncertain(no(odds).round() as u32))
            .collect(),
    }
});

/// Bytes by N contexts.
pub(super) struct Bytes<const N: usize> {
    probs: [Vec<[Prob; 256]>; N],
    /// Weights of the contexts by the bits that are known.
    weights: Vec<[i32; N]>,
}

impl<const N: usize> Bytes<N> {
    /// With so many values of each context.
    pub(super) fn new(contexts: [usize; N]) -> Self {
        Self {
            probs: contexts.map(|n| vec![[Prob::default(); 256]; n]),
            weights: vec![[UNIT * 2 / 5; N]; 256],
        }
    }

    /// Codes a byte.
    #[inline]
    pub(super) fn code(&mut self, coder: &mut impl Coder, contexts: [usize; N], value: u8) -> u8 {
        let tables = &*TABLES;
        // The bits that are known, below a leading one.
        let mut known = 1usize;
        for place in (0..8).rev() {
            let weights = &mut self.weights[known];
            let odds: [i32; N] = std::array::from_fn(|k| {
                tables.odds[(self.probs[k][contexts[k]][known].no() / STEP) as usize]
            });
            let sum: i64 = (0..N).map(|k| i64::from(odds[k]) * i64::from(weights[k])).sum();
            let sum = (sum / i64::from(UNIT)).clamp(-i64::from(MOST), i64::from(MOST));
            let no = tables.no[(sum + i64::from(MOST)) as usize];
            let yes = coder.decide(no, value >> place & 1 == 1);
            let error = if yes { 0 } else { ONE as i32 } - no as i32;
            for k in 0..N {
                weights[k] += (odds[k] * error) >> SLOWNESS;
                self.probs[k][contexts[k]][known].learn(yes);
            }
            known = known << 1 | usize::from(yes);
        }
        known as u8
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Files depend on the tables, which come of floating point: they must be the same on every machine.
    #[test]
    fn tables_are_those_that_files_were_written_with() {
        let odds = TABLES.odds.iter().flat_map(|v| v.to_le_bytes());
        let all: Vec<u8> = odds
            .chain(TABLES.no.iter().flat_map(|v| v.to_le_bytes()))
            .collect();
        assert_eq!(crc32fast::hash(&all), 1_668_558_082);
    }
}
