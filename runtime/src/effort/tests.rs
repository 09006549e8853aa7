//! The controller against machines that are simulated: what a frame takes, with noise, known some frames late.

use super::*;
use proptest::prelude::*;

const PIXELS: f64 = 640.0 * 360.0;

/// What a frame takes.
#[derive(Clone, Debug)]
struct Machine {
    other_ms: f64,
    /// Of the rays at full effort.
    cast_ms: f64,
    /// The time of the rays goes with the pixels to this power.
    power: f64,
    /// What it is divided by for an octave of bias.
    ratio: f64,
    /// Largest part by which a frame differs from that.
    noise: f64,
    latency: usize,
}

impl Machine {
    fn ms(&self, effort: Effort) -> f64 {
        self.other_ms + self.cast_ms * (effort.scale.powi(2)).powf(self.power) / self.ratio.powf(effort.bias)
    }
}

/// A machine that draws frames for a controller.
struct Run {
    machine: Machine,
    controller: EffortController,
    wanted: Wanted,
    under_way: VecDeque<Cost>,
    random: u64,
}

impl Run {
    fn new(machine: Machine, target_ms: f64) -> Self {
        Self {
            machine,
            controller: EffortController::default(),
            wanted: Wanted {
                target_ms,
                pixels: PIXELS,
                bias: -1.0,
                memory: 0.0,
                rests: false,
            },
            under_way: VecDeque::new(),
            random: 0x9e37_79b9_7f4a_7c15,
        }
    }

    /// Evenly from 1 − noise to 1 + noise.
    fn noise(&mut self) -> f64 {
        self.random ^= self.random << 13;
        self.random ^= self.random >> 7;
        self.random ^= self.random << 17;
        1.0 + self.machine.noise * ((self.random >> 11) as f64 / (1u64 << 52) as f64 - 1.0)
    }

    fn frame(&mut self) -> Effort {
        if self.under_way.len() > self.machine.latency
            && let Some(cost) = self.under_way.pop_front()
        {
            self.controller.measured(cost);
        }
        let effort = self.controller.next(Some(&self.wanted));
        let noise = self.noise();
        let bias = effort.bias.max(self.wanted.memory);
        let cast_ms = self.machine.ms(Effort { bias, ..effort }) - self.machine.other_ms;
        self.under_way.push_back(Cost {
            pixels: PIXELS * effort.scale * effort.scale,
            bias: self.wanted.bias + bias,
            cast_ms: cast_ms * noise,
            other_ms: self.machine.other_ms * noise,
        });
        effort
    }

    fn frames(&mut self, count: usize) -> Vec<Effort> {
        (0..count).map(|_| self.frame()).collect()
    }
}

fn changes(efforts: &[Effort]) -> usize {
    efforts.windows(2).filter(|w| w[0] != w[1]).count()
}

fn plain() -> Machine {
    Machine {
        other_ms: 2.0,
        cast_ms: 28.0,
        power: 1.0,
        ratio: 1.4,
        noise: 0.0,
        latency: 2,
    }
}

fn machines() -> impl Strategy<Value = Machine> {
    (0.0..0.3, 0.7..1.0, 1.0..3.0, 0.0..0.2, 1usize..5).prop_map(|(other, power, ratio, noise, latency)| {
        Machine {
            other_ms: 30.0 * other,
            cast_ms: 30.0 * (1.0 - other),
            power,
            ratio,
            noise,
            latency,
        }
    })
}

proptest! {
    #[test]
    fn a_constant_load_settles_and_stays(machine in machines(), target_ms in 3.0..60.0) {
        let mut run = Run::new(machine.clone(), target_ms);
        let all = run.frames(3000);
        // One rung a frame at most.
        for pair in all.windows(2) {
            prop_assert!((pair[0].bias - pair[1].bias).abs() <= 0.125, "{pair:?}");
        }
        let late = &all[1000..];
        prop_assert!(changes(&all) <= 28, "{} changes", changes(&all));
        // Noise may show a finer rung as cheap enough: tried a few times, each after a wait of four times the last one.
        prop_assert!(changes(late) <= 8, "{} changes", changes(late));
        // What goes to and fro does so between neighbours: a rung down undoes a rung up, but for two where noise is seen as a load.
        let steps = late.windows(2).map(|w| w[1].bias - w[0].bias).filter(|s| *s != 0.0);
        let steps: Vec<f64> = steps.collect();
        prop_assert!(steps.windows(3).all(|w| w.iter().any(|step| *step < 0.0)), "{steps:?}");
        // Within the time if it can be, and not far below what would be possible.
        let last = late[late.len() - 1];
        let ms = machine.ms(last);
        prop_assert!(ms <= target_ms || last == Effort::of(LAST), "{last:?}: {ms} of {target_ms} ms");
        let rung = (last.bias * 8.0) as u32;
        if let Some(finer) = rung.checked_sub(1) {
            let finer = machine.ms(Effort::of(finer));
            prop_assert!(finer > 0.6 * target_ms, "{last:?}: {finer} of {target_ms} ms would be possible");
        }
    }
}

#[test]
fn a_load_within_its_time_is_drawn_in_full() {
    let mut run = Run::new(plain(), 30.1);
    assert!(run.frames(500).iter().all(|e| *e == Effort::FULL));
}

#[test]
fn a_miss_is_answered_within_a_few_frames_and_its_end_slowly() {
    let mut run = Run::new(plain(), 40.0);
    run.frames(100);
    run.machine.cast_ms = 60.0;
    let heavy = run.frames(20);
    // Three measurements of five, each two frames late.
    let first = heavy.iter().position(|e| *e != Effort::FULL);
    assert!(first.is_some_and(|k| k <= 6), "{heavy:?}");
    assert!(run.machine.ms(heavy[19]) <= 40.0, "{:?}", heavy[19]);
    run.machine.cast_ms = 28.0;
    let light = run.frames(300);
    assert_eq!(light[10], heavy[19], "not at once");
    assert_eq!(light[299], Effort::FULL);
    assert_eq!(changes(&light) as f64, heavy[19].bias * 8.0);
}

#[test]
fn spikes_of_single_frames_change_nothing() {
    let mut run = Run::new(plain(), 32.0);
    run.frames(20);
    for _ in 0..20 {
        run.machine.cast_ms = 200.0;
        run.frame();
        run.machine.cast_ms = 28.0;
        assert!(run.frames(9).iter().all(|e| *e == Effort::FULL));
    }
}

#[test]
fn a_camera_that_rests_gets_the_whole_picture_step_by_step_and_goes_on_as_before() {
    let mut run = Run::new(plain(), 12.0);
    let moving = run.frames(100)[99];
    assert!(moving.scale < 1.0 && moving.bias >= 0.5);
    run.wanted.rests = true;
    let rest = run.frames(200);
    assert!(rest[..4].iter().all(|e| *e == moving), "a halt");
    assert!(
        rest.windows(2)
            .all(|w| w[0].bias - w[1].bias <= 0.125 && w[0].bias >= w[1].bias)
    );
    assert!(rest[30..].iter().all(|e| *e == Effort::FULL));
    run.wanted.rests = false;
    let again = run.frames(100);
    assert!(again.iter().all(|e| *e == moving), "{again:?}");
}

#[test]
fn a_return_that_fails_is_tried_less_and_less_often() {
    // A finer picture takes far more than pixels say.
    let surprising = Machine {
        power: 3.0,
        ratio: 1.0,
        ..plain()
    };
    let mut run = Run::new(surprising, 5.4);
    let all = run.frames(6000);
    let (early, late) = (changes(&all[..3000]), changes(&all[3000..]));
    assert!(late <= 4 && early <= 32, "{early}, then {late}");
}

#[test]
fn what_memory_asks_for_is_not_asked_for_twice() {
    let mut run = Run::new(plain(), 24.0);
    run.wanted.memory = 1.0;
    // An octave of bias is there already, 2 + 28 / 1.4 ms, and an eighth in place of it gains nothing.
    assert!(run.frames(100).iter().all(|e| *e == Effort::FULL));
    let eighth = run.controller.few(&run.wanted, 1);
    assert!(eighth.is_some_and(|ms| (ms - 22.0).abs() < 1e-9), "{eighth:?}");
}

#[test]
fn without_a_target_all_is_drawn_and_the_next_movement_goes_on() {
    let mut run = Run::new(plain(), 12.0);
    let moving = run.frames(100)[99];
    assert_eq!(run.controller.next(None), Effort::FULL);
    assert_eq!(run.frame(), moving);
    // A measurement without a meaning is dropped.
    let before = run.controller.costs.clone();
    let zero = Cost {
        pixels: 1.0,
        bias: 0.0,
        cast_ms: 0.0,
        other_ms: 1.0,
    };
    run.controller.measured(zero);
    run.controller.measured(Cost {
        cast_ms: f64::NAN,
        ..zero
    });
    assert_eq!(run.controller.costs, before);
}

#[test]
fn the_ratio_of_an_octave_is_learnt() {
    let mut octave = Octave::default();
    assert!((octave.ratio() - Octave::USUAL).abs() < 1e-12);
    for k in 0..400 {
        let bias = f64::from(k % 16) / 8.0;
        octave.learn(bias, 1.0 - bias * 2f64.ln());
    }
    assert!((octave.ratio() - 2.0).abs() < 0.1, "{}", octave.ratio());
}

#[test]
fn no_rung_has_pixels_larger_than_its_levels_ask_for() {
    for rung in 0..=LAST {
        let effort = Effort::of(rung);
        assert!(effort.scale >= (-effort.bias).exp2() && effort.scale >= 0.5);
        assert_eq!(effort.size(1, 1), [1, 1]);
    }
    assert_eq!((Effort::of(0), Effort::of(1).scale), (Effort::FULL, 1.0));
    assert_eq!(Effort::of(5).scale, std::f64::consts::FRAC_1_SQRT_2);
    assert_eq!(
        Effort::of(LAST),
        Effort {
            bias: 2.0,
            scale: 0.5
        }
    );
    assert_eq!(Effort::of(8).size(641, 360), [321, 180]);
}
