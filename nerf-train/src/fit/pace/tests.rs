use super::*;

/// Simulated machine: seconds of each kind of work, and a clock that only this work advances.
struct Machine {
    now: f64,
    reading: f64,
    step: f64,
    file: f64,
    pixel: f64,
    /// Factor on the seconds per pixel if no occupancy grid is used.
    dense: f64,
}

/// Number of pixels of a small view, 200 × 200.
const SMALL: u64 = 40_000;
/// Number of pixels of a phone's photograph.
const LARGE: u64 = 1080 * 1920;

/// Simulates a fit with `views` validation views of `view` pixels. Returns the seconds of the whole fit, the
/// seconds of validation during training, and the number of validations.
fn run(mut machine: Machine, seconds: f64, view: u64, views: u64) -> (f64, f64, usize) {
    let mut pace = Pace::new(Some(seconds), true, true);
    machine.now += machine.reading;
    let (asked, watched, mut validations) = (3 * view, 2u64, 0);
    let render = |machine: &mut Machine, pace: &mut Pace, pixels: u64, step: u32, dense: f64| {
        let taken = pixels / u64::from(step).pow(2);
        machine.now += taken as f64 * machine.pixel * dense;
        if dense == 1.0 {
            pace.measured(taken, taken as f64 * machine.pixel);
        }
    };
    let (mut last, mut way) = (0.0, 0.0);
    let on_lattice = asked / u64::from(pace.lattice_on_the_way(asked, view, f64::INFINITY)).pow(2);
    while machine.now + machine.step < seconds - pace.reserve(views * view, on_lattice) {
        if machine.now - last > seconds / 8.0 && pace.affords(machine.now, 2) {
            let (from, allowed) = (machine.now, pace.allowance(machine.now));
            machine.now += machine.file;
            pace.made(machine.file);
            if !pace.knows() {
                let step = pace.probe(view);
                render(&mut machine, &mut pace, watched * view, step, 1.0);
            }
            let left = allowed - (machine.now - from);
            if left > 0.0 {
                let step = pace.lattice_on_the_way(watched * view, view, left);
                render(&mut machine, &mut pace, watched * view, step, 1.0);
            }
            pace.validated(machine.now - from);
            (last, way, validations) = (machine.now, way + machine.now - from, validations + 1);
        }
        machine.now += machine.step;
    }
    machine.now += machine.file;
    for (pixels, share, dense) in [
        (asked, QUESTION_SHARE, 1.0),
        (asked, QUESTION_SHARE, 1.0),
        (asked, QUESTION_SHARE, 1.0),
        (asked, QUESTION_SHARE, 1.0),
        (asked, QUESTION_SHARE, machine.dense),
        (views * view, FINAL_SHARE, 1.0),
        (views * view, QUESTION_SHARE, 1.0),
    ] {
        // For a rendering without the occupancy grid, the time per pixel is measured first.
        let mut asked =
            if dense == 1.0 && pace.knows() { pace } else { Pace::new(Some(seconds), true, true) };
        if !asked.knows() {
            let step = asked.probe(view);
            let from = machine.now;
            render(&mut machine, &mut pace, pixels, step, dense);
            asked.measured(pixels / u64::from(step).pow(2), machine.now - from);
        }
        let step = match pixels == 3 * view {
            true => asked.lattice_on_the_way(pixels, view, pace.share(share)),
            false => asked.lattice(pixels, view, pace.share(share)),
        };
        render(&mut machine, &mut pace, pixels, step, dense);
    }
    (machine.now + WRITING[1], way, validations)
}

#[test]
fn a_limit_in_seconds_is_kept_whatever_work_costs() {
    for seconds in [10.0, 30.0, 120.0, 600.0] {
        for (view, views) in [(SMALL, 10), (SMALL, 100), (LARGE, 7)] {
            for pixel in [1e-7, 1e-6, 1e-5, 5e-5] {
                for (step, file) in [(1e-3, 5e-3), (0.05, 0.1), (0.5, 0.02)] {
                    for dense in [1.0, 10.0, 30.0] {
                        let machine = Machine { now: 0.0, reading: 1.0, step, file, pixel, dense };
                        let (total, way, validations) = run(machine, seconds, view, views);
                        let case = format!(
                            "{seconds} s, {views}×{view} pixels of {pixel}, steps of {step}, dense {dense}: \
                             {total:.2} s, validation {way:.2} s in {validations}"
                        );
                        assert!(total <= seconds + (0.05 * seconds).max(2.0), "{case}");
                        assert!(way <= 1.02 * VALIDATION_SHARE * seconds + 0.01, "{case}");
                        // Most of the time limit is used.
                        assert!(total >= 0.7 * seconds, "{case}");
                    }
                }
            }
        }
    }
}

#[test]
fn lattices_are_odd_and_no_coarser_than_asked() {
    assert_eq!([1.0, 1e9, 0.0].map(|count| lattice_of(1, count)), [1, 1, 1]);
    assert_eq!(lattice_of(40_000, 40_000.0), 1);
    assert_eq!(lattice_of(40_000, 39_999.0), 3);
    assert_eq!(lattice_of(LARGE, 40_000.0), 9);
    assert_eq!(Pace::new(None, true, true).reserve(1 << 30, 1 << 20), 0.0);
    assert_eq!(Pace::new(None, false, true).lattice(1 << 40, 1 << 30, f64::INFINITY), 1);
    assert!(Pace::new(None, false, true).affords(0.0, 2));
}
