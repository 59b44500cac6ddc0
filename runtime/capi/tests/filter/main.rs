//! Tests the laws of `poegp_command` by calling it as C would.

mod refused;

use std::mem::{MaybeUninit, offset_of};
use std::ptr::{null, null_mut};

use poegp_capi::codes::*;
use poegp_capi::types::*;
use poegp_capi::*;
use poegp_protocol::blob;
use poegp_runtime::filter;
use poegp_runtime::filter::CommandFilter;
use poegp_runtime::guard::status::Status;
use poegp_runtime::model::{Model as Arm, words_for};

const BLOB: &[u8] = include_bytes!("../../examples/arm.blob");
const COMMAND: [f32; 6] = [0.3, -0.2, 0.4, 0.1, 0.7, -0.5];
const PERIOD: f32 = 0.01;
/// Rate limit of the usual settings, rad per cycle.
const RATE: f32 = 0.02 * PERIOD;
/// Enough cycles to switch the correction on or off.
const LONG: usize = 400;
/// Allowance for the rounding of a joint, rad.
const ROUNDING: f32 = 5e-7;

type Capacity = Arm<f32, { words_for(64) }>;

#[repr(C, align(8))]
struct ModelMemory([u8; POEGP_MODEL_BYTES]);
#[repr(C, align(8))]
struct FilterMemory([u8; POEGP_FILTER_BYTES]);

/// A model and a filter of the C interface, and the same model in Rust.
struct Cell {
    model: *mut Model,
    filter: *mut Filter,
    arm: Box<Capacity>,
    memory: (*mut ModelMemory, *mut FilterMemory),
}

impl Cell {
    fn new(bytes: &[u8]) -> Self {
        // Pointers, because moving a box would invalidate them.
        let memory = (
            Box::into_raw(Box::new(ModelMemory([0; POEGP_MODEL_BYTES]))),
            Box::into_raw(Box::new(FilterMemory([0; POEGP_FILTER_BYTES]))),
        );
        let start = memory.0.cast();
        let mut model = null_mut();
        // SAFETY: the memory is as large as is said, and nobody else's.
        let code = unsafe { poegp_init(start, POEGP_MODEL_BYTES, &raw mut model) };
        assert_eq!(code, POEGP_OK);
        // SAFETY: a slice is as long as it says.
        let code = unsafe { poegp_load(model, bytes.as_ptr(), bytes.len()) };
        assert_eq!(code, POEGP_OK);
        let mut arm = Box::new(Arm::new());
        arm.load_decoded(&blob::decode(bytes).unwrap()).unwrap();
        let start = memory.1.cast();
        let (code, filter) = make(start, POEGP_FILTER_BYTES, &usual());
        assert_eq!(code, POEGP_OK);
        Self {
            model,
            filter,
            arm,
            memory,
        }
    }

    fn command(&self, joints: &[f32], engage: bool) -> Commanded {
        let asked = Asked {
            engage,
            ..Asked::new(joints)
        };
        let (code, answer) = command(self.model, self.filter, &asked);
        assert_eq!(code, POEGP_OK);
        answer
    }

    fn counts(&self) -> FilterCounts {
        let mut counts = FilterCounts::default();
        // SAFETY: pointers are good.
        let code = unsafe { poegp_filter_counts(self.filter, &raw mut counts) };
        assert_eq!(code, POEGP_OK);
        counts
    }

    fn is_disengaged(&self) -> bool {
        is_disengaged(self.filter)
    }

    /// Returns a cell whose filter was switched on at this command and has settled.
    fn engaged(bytes: &[u8], joints: &[f32]) -> Self {
        let cell = Self::new(bytes);
        for _ in 0..LONG {
            cell.command(joints, true);
        }
        assert_eq!(cell.command(joints, true).status & POEGP_STATUS_BLENDING, 0);
        cell
    }
}

impl Drop for Cell {
    fn drop(&mut self) {
        let (model, filter) = self.memory;
        // SAFETY: from a box, and nobody uses it any longer.
        drop(unsafe { Box::from_raw(model) });
        // SAFETY: the same.
        drop(unsafe { Box::from_raw(filter) });
    }
}

/// The arguments of a call.
#[derive(Clone, Copy)]
struct Asked<'a> {
    joints: &'a [f32],
    payload_kg: f32,
    engage: bool,
    cycles: u32,
}

impl<'a> Asked<'a> {
    fn new(joints: &'a [f32]) -> Self {
        Self {
            joints,
            payload_kg: 1.0,
            engage: true,
            cycles: 1,
        }
    }
}

fn command(model: *const Model, filter: *mut Filter, asked: &Asked) -> (i32, Commanded) {
    let mut out = MaybeUninit::uninit();
    // SAFETY: a slice is as long as it says; no test has a second thread.
    let code = unsafe {
        poegp_command(
            model,
            filter,
            asked.joints.as_ptr(),
            asked.joints.len(),
            asked.payload_kg,
            i32::from(asked.engage),
            asked.cycles,
            out.as_mut_ptr(),
        )
    };
    // SAFETY: written whatever the code is, because the pointer to it is good.
    (code, unsafe { out.assume_init() })
}

fn correct(model: *const Model, joints: &[f32]) -> Corrected {
    let mut out = MaybeUninit::uninit();
    // SAFETY: a slice is as long as it says.
    let code =
        unsafe { poegp_correct(model, joints.as_ptr(), joints.len(), 1.0, out.as_mut_ptr()) };
    assert_eq!(code, POEGP_OK);
    // SAFETY: written, since the pointer to it is good.
    unsafe { out.assume_init() }
}

fn is_disengaged(filter: *const Filter) -> bool {
    // SAFETY: what is no filter is refused.
    unsafe { poegp_filter_disengaged(filter) != 0 }
}

fn usual() -> FilterSettings {
    let mut settings = MaybeUninit::uninit();
    // SAFETY: the pointer is good.
    let code = unsafe { poegp_filter_defaults(PERIOD, settings.as_mut_ptr()) };
    assert_eq!(code, POEGP_OK);
    // SAFETY: written.
    unsafe { settings.assume_init() }
}

fn make(start: *mut u8, bytes: usize, settings: *const FilterSettings) -> (i32, *mut Filter) {
    let mut filter = start.cast::<Filter>();
    // SAFETY: never more bytes than are there; what is wrong with them is refused.
    let code = unsafe { poegp_filter_init(start.cast(), bytes, settings, &raw mut filter) };
    assert_eq!(filter.is_null(), code != POEGP_OK, "{code}");
    (code, filter)
}

/// Returns the blob with other numbers.
fn another_arm() -> Vec<u8> {
    let mut blob = blob::decode(BLOB).unwrap();
    blob.geometry.calibrated[2][3] += 0.004;
    let mut buffer = vec![0; BLOB.len() + 64];
    blob::encode(&blob, &mut buffer).unwrap().to_vec()
}

/// SplitMix64.
struct Dice(u64);

impl Dice {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }
    fn is(&mut self, one_in: u64) -> bool {
        self.next().is_multiple_of(one_in)
    }
    fn within(&mut self, from: f32, to: f32) -> f32 {
        from + (to - from) * ((self.next() >> 40) as f32 / 16_777_216.0)
    }
}

/// Returns `poegp_command` composed from parts of the runtime, as its documentation describes.
fn composed(filter: &mut CommandFilter<f32>, arm: &Capacity, asked: &Asked) -> Commanded {
    let payload = filter.payload(asked.payload_kg, asked.cycles);
    let corrected = arm.correct(asked.joints, payload);
    let sent = filter.step(
        asked.joints,
        &corrected.joints,
        corrected.status,
        asked.engage,
        asked.cycles,
    );
    let bypassed = if asked.engage {
        Status::OK
    } else {
        Status::BYPASSED
    };
    Commanded {
        joints: sent.joints,
        weight: sent.weight,
        applied: corrected.applied,
        position_error: corrected.position_error,
        rotation_error: corrected.rotation_error,
        status: u32::from(sent.status.with(bypassed).bits()),
    }
}

#[test]
fn a_random_path_has_the_bits_of_the_runtime() {
    let other = another_arm();
    let [cell, spare] = [BLOB, &other].map(Cell::new);
    let mut mirror = CommandFilter::new();
    mirror
        .configure(&filter::FilterSettings::with_period(PERIOD))
        .unwrap();
    let mut dice = Dice(11);
    let mut active = &cell;
    let mut joints = COMMAND;
    let (mut speed, mut payload_kg, mut engage) = ([0.0; 6], 1.0, true);
    let (mut blending, mut exchanged) = (0, 0);
    for _ in 0..10_000 {
        if dice.is(200) {
            engage = !engage;
        }
        if dice.is(150) {
            payload_kg = dice.within(0.0, 5.0);
        }
        if dice.is(100) {
            speed = std::array::from_fn(|_| dice.within(-0.5, 0.5) * PERIOD);
        }
        if dice.is(500) {
            joints = COMMAND;
        }
        for (joint, step) in joints.iter_mut().zip(&speed) {
            *joint += *step;
        }
        // The model is usually exchanged while disengaged, as it should be, and rarely while not.
        if dice.is(if is_disengaged(cell.filter) { 20 } else { 900 }) {
            active = if active.model == cell.model {
                &spare
            } else {
                &cell
            };
            exchanged += 1;
        }
        let mut given = joints;
        if dice.is(60) {
            given[3] = [f32::NAN, f32::INFINITY, 1e30][(dice.next() % 3) as usize];
        }
        let odd = dice.is(90);
        let asked = Asked {
            joints: if dice.is(2_000) { &given[..5] } else { &given },
            payload_kg: if odd { f32::NAN } else { payload_kg },
            engage,
            cycles: match dice.next() % 40 {
                0 => 0,
                1 => 3,
                2 => 50,
                _ => 1,
            },
        };
        let (code, found) = command(active.model, cell.filter, &asked);
        let fits = asked.joints.len() == 6;
        assert_eq!(code, if fits { POEGP_OK } else { POEGP_ERROR_JOINTS });
        // What leaves out a joint that was sent before is no command.
        let none = [f32::NAN; 9];
        let asked = Asked {
            joints: if fits { asked.joints } else { &none },
            ..asked
        };
        let expected = composed(&mut mirror, &active.arm, &asked);
        let bits = |answer: &Commanded| answer.joints.map(f32::to_bits);
        assert_eq!(bits(&found), bits(&expected));
        assert_eq!(found, expected);
        assert_eq!(is_disengaged(cell.filter), mirror.disengaged());
        blending += u32::from(found.status & POEGP_STATUS_BLENDING != 0);
    }
    let (found, expected) = (cell.counts(), mirror.counts());
    assert_eq!(
        [
            found.held,
            found.lost,
            found.doubled,
            found.bad,
            found.guarded
        ],
        [
            expected.held,
            expected.lost,
            expected.doubled,
            expected.bad,
            expected.guarded
        ]
    );
    assert!(blending > 500 && exchanged > 20, "{blending} {exchanged}");
    assert!(found.held > 0 && found.guarded > 0 && found.bad > 0);
}

#[test]
fn switched_on_it_is_the_corrected_command_and_switched_off_the_command() {
    let cell = Cell::new(BLOB);
    let corrected = correct(cell.model, &COMMAND);
    assert_ne!(corrected.joints[..6], COMMAND);
    let mut last = cell.command(&COMMAND, true);
    for engage in [true, false] {
        for _ in 0..LONG {
            let answer = cell.command(&COMMAND, engage);
            for (now, before) in answer.joints.iter().zip(&last.joints) {
                assert!((now - before).abs() <= RATE + ROUNDING);
            }
            last = answer;
        }
        assert_eq!(cell.is_disengaged(), !engage);
        if engage {
            assert_eq!(last.joints, corrected.joints);
            assert_eq!((last.status, last.weight), (corrected.status, 1.0));
            assert_eq!(
                (last.applied, last.position_error, last.rotation_error),
                (
                    corrected.applied,
                    corrected.position_error,
                    corrected.rotation_error
                )
            );
        } else {
            assert_eq!(last.joints[..6], COMMAND);
            let bypassed = corrected.status | POEGP_STATUS_BYPASSED;
            assert_eq!((last.status, last.weight), (bypassed, 0.0));
        }
    }
}

/// The command passes to the bit, also −0, whatever the model is or refuses.
#[test]
fn switched_off_the_command_passes_whatever_the_model_says() {
    let cell = Cell::new(BLOB);
    let mut dice = Dice(4);
    for round in 0..2_000 {
        let mut joints: [f32; 6] = std::array::from_fn(|_| dice.within(-7e3, 7e3));
        joints[round % 6] = -0.0;
        let asked = Asked {
            joints: &joints,
            payload_kg: [1.0, f32::NAN, -1.0, 1e30][round % 4],
            engage: false,
            cycles: (dice.next() % 8) as u32 + 1,
        };
        let model = if dice.is(3) {
            null()
        } else {
            cell.model.cast_const()
        };
        let (code, answer) = command(model, cell.filter, &asked);
        assert_eq!(code == POEGP_OK, !model.is_null());
        for (sent, joint) in answer.joints.iter().zip(&joints) {
            assert_eq!(sent.to_bits(), joint.to_bits());
        }
        assert_ne!(answer.status & POEGP_STATUS_BYPASSED, 0);
        // What passes is not bad.
        assert_eq!(answer.status & POEGP_STATUS_BAD_INPUT, 0);
        assert!(cell.is_disengaged());
    }
    assert_eq!(cell.counts().bad, 0);
}

#[test]
fn a_model_is_exchanged_while_disengaged() {
    let other = another_arm();
    let spare = Cell::new(&other);
    let cell = Cell::engaged(BLOB, &COMMAND);
    let first = cell.command(&COMMAND, true);
    // Switched off, and exchanged as soon as the filter is disengaged.
    let mut waited = 0;
    while !cell.is_disengaged() {
        assert!(cell.command(&COMMAND, false).status & POEGP_STATUS_BYPASSED != 0);
        waited += 1;
        assert!(waited < LONG);
    }
    assert!(waited > 10, "{waited}");
    let mut last = COMMAND;
    for engage in [false, true] {
        for _ in 0..LONG {
            let asked = Asked {
                engage,
                ..Asked::new(&COMMAND)
            };
            let (code, answer) = command(spare.model, cell.filter, &asked);
            assert_eq!(code, POEGP_OK);
            for (now, before) in answer.joints.iter().zip(&last) {
                assert!((now - before).abs() <= RATE + ROUNDING);
            }
            last.copy_from_slice(&answer.joints[..6]);
        }
    }
    assert_eq!(last, correct(spare.model, &COMMAND).joints[..6]);
    assert_ne!(last, first.joints[..6]);
    assert_eq!(cell.counts(), FilterCounts::default());
}

/// A model that is exchanged, lost or removed while its correction is applied, against the rules, does not make the output
/// step.
#[test]
fn a_model_that_changes_or_goes_does_not_step() {
    let other = another_arm();
    let spare = Cell::new(&other);
    let goes = (null(), POEGP_ERROR_NULL, COMMAND);
    let target = correct(spare.model, &COMMAND).joints;
    let mut changed = COMMAND;
    changed.copy_from_slice(&target[..6]);
    for (model, expected, target) in [(spare.model.cast_const(), POEGP_OK, changed), goes] {
        let cell = Cell::engaged(BLOB, &COMMAND);
        let mut last = cell.command(&COMMAND, true).joints;
        for _ in 0..LONG {
            assert!(!cell.is_disengaged());
            let (code, answer) = command(model, cell.filter, &Asked::new(&COMMAND));
            assert_eq!(code, expected);
            let without = answer.status & POEGP_STATUS_NO_MODEL != 0;
            assert_eq!(without, model.is_null());
            for (now, before) in answer.joints.iter().zip(&last) {
                assert!((now - before).abs() <= RATE + ROUNDING);
            }
            last = answer.joints;
        }
        assert_eq!(last[..6], target);
        assert_eq!(cell.counts().guarded, 1);
    }
}
