//! Looks in steps: colours and normals of which only every so many are used, so that they take fewer bytes and none is off by
//! more than a bound.

/// The codes of a component of a look that are used: zero, and every so many from there, and the ends of the range.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Steps {
    /// Codes from one to the next.
    step: i32,
}

/// The code of a colour's zero, and of a normal's as an unsigned byte.
pub(crate) const COLOR_ZERO: u8 = 0;
pub(crate) const NORMAL_ZERO: u8 = 0x80;

impl Steps {
    /// The largest bound.
    pub const MOST: u8 = 15;

    /// Steps by which no code is off by more than `error`, at most [`Self::MOST`]; 0 are all codes.
    pub fn within(error: u8) -> Self {
        Self {
            step: 2 * i32::from(error.min(Self::MOST)) + 1,
        }
    }

    /// Codes from one to the next.
    pub(crate) fn step(self) -> i32 {
        self.step
    }

    /// The number of the step nearest to a code.
    #[inline]
    pub(crate) fn number(self, zero: u8, code: u8) -> i32 {
        let from = i32::from(code) - i32::from(zero);
        (2 * from + self.step).div_euclid(2 * self.step)
    }

    /// The code of a step. Where all codes are steps, numbers beyond the range begin anew at its other end.
    #[inline]
    pub(crate) fn code(self, zero: u8, number: i32) -> u8 {
        let code = i32::from(zero) + number.wrapping_mul(self.step);
        if self.step == 1 {
            code as u8
        } else {
            code.clamp(0, 255) as u8
        }
    }

    /// The step nearest to a code.
    #[inline]
    pub fn nearest(self, zero: u8, code: u8) -> u8 {
        self.code(zero, self.number(zero, code))
    }

    /// The numbers of the first and the last step in a range of codes; in the wrong order if there is none.
    #[inline]
    pub(crate) fn in_range(self, zero: u8, [low, high]: [u8; 2]) -> [i32; 2] {
        let (first, last) = (self.number(zero, low), self.number(zero, high));
        [
            first + i32::from(self.code(zero, first) < low),
            last - i32::from(self.code(zero, last) > high),
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_code_is_off_by_more_than_the_bound_and_steps_stay_where_they_are() {
        for error in 0..=Steps::MOST {
            let steps = Steps::within(error);
            for zero in [COLOR_ZERO, NORMAL_ZERO] {
                assert_eq!(steps.nearest(zero, zero), zero);
                for code in 0..=255u8 {
                    let nearest = steps.nearest(zero, code);
                    assert!(nearest.abs_diff(code) <= error, "{error} {zero} {code} {nearest}");
                    assert_eq!(steps.nearest(zero, nearest), nearest);
                }
            }
        }
    }

    #[test]
    fn steps_in_ranges_are_those_of_a_search() {
        for error in [0, 1, 4, 6, 15] {
            let steps = Steps::within(error);
            for (low, high) in (0..=255u8)
                .step_by(3)
                .flat_map(|l| (l..=255).step_by(5).map(move |h| (l, h)))
            {
                let [first, last] = steps.in_range(COLOR_ZERO, [low, high]);
                let any = (low..=high).any(|code| steps.nearest(COLOR_ZERO, code) == code);
                assert_eq!(first <= last, any, "{error} {low} {high}");
                if any {
                    let ends = [first, last].map(|n| steps.code(COLOR_ZERO, n));
                    assert!(ends.iter().all(|code| (low..=high).contains(code)));
                }
            }
        }
    }
}
