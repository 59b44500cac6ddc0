//! The laws of `poegp_command`, kept by calling it as C would.

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

const BLOB: &[u8] = include_bytes!("../examples/arm.blob");
const COMMAND: [f32; 6] = [0.3, -0.2, 0.4, 0.1, 0.7, -0.5];
const PERIOD: f32 = 0.01;
/// Of the usual settings, rad per cycle.
const RATE: f32 = 0.02 * PERIOD;
/// Enough to switch the correction on or off.
const LONG: usize = 400;
/// Rounding of a joint.
const ROUNDING: f32 = 5e-7;

type Capacity = Arm<f32, { words_for(32) }>;

#[repr(C, align(8))]
struct ModelMemory([u8; POEGP_MODEL_BYTES]);
#[repr(C, align(8))]
struct FilterMemory([u8; POEGP_FILTER_BYTES]);

/// A model and a filter as C has them, and the model as Rust has it.
struct Cell {
    model: *mut Model,
    filter: *mut Filter,
    arm: Box<Capacity>,
    memory: (*mut ModelMemory, *mut FilterMemory),
}

impl Cell {
    fn new(bytes: &[u8]) -> Self {
        // Pointers, since a box that moves asks for its memory anew.
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

    /// The filter switched on at this command, and arrived.
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

/// A call.
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

/// The blob with other numbers.
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

/// `poegp_command` as it is said to be made of the runtime's parts.
fn composed(filter: &mut CommandFilter<f32>, arm: &Capacity, asked: &Asked) -> Commanded {
    let payload = filter.payload(asked.payload_kg, asked.cycles);
    let corrected = arm.correct(asked.joints, payload);
    let away = !asked.engage && filter.disengaged();
    let status = if away { Status::OK } else { corrected.status };
    let sent = filter.step(
        asked.joints,
        &corrected.joints,
        status,
        asked.engage,
        asked.cycles,
    );
    let bypassed = u32::from(Status::BYPASSED.bits()) * u32::from(!asked.engage);
    Commanded {
        joints: sent.joints,
        weight: sent.weight,
        applied: corrected.applied,
        position_error: corrected.position_error,
        rotation_error: corrected.rotation_error,
        status: u32::from(sent.status.with(corrected.status).bits()) | bypassed,
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
        // Exchanged as it should be, and rarely as it should not.
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
        assert_eq!(code, POEGP_OK);
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

/// To the bit, also −0, whatever the model is and refuses.
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
    // Switched off, and exchanged as soon as the filter says so.
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

/// Not as it should be: exchanged, lost, or taken away while it is applied. What is sent does not step either.
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

#[test]
fn memory_and_settings_that_are_none_are_refused() {
    let mut memory = FilterMemory([0; POEGP_FILTER_BYTES]);
    let start = (&raw mut memory).cast::<u8>();
    let size = poegp_filter_size();
    assert!(size <= POEGP_FILTER_BYTES);
    assert_eq!(poegp_filter_align(), POEGP_FILTER_ALIGN);
    let good = usual();
    let runtime = filter::FilterSettings::with_period(PERIOD);
    assert_eq!(
        [good.period_s, good.rate, good.acceleration, good.blend_s],
        [
            runtime.period_s,
            runtime.rate,
            runtime.acceleration,
            runtime.blend_s
        ]
    );
    let code = |start, bytes, settings: *const FilterSettings| make(start, bytes, settings).0;
    assert_eq!(code(null_mut(), size, &raw const good), POEGP_ERROR_NULL);
    assert_eq!(code(start, size, null()), POEGP_ERROR_NULL);
    let odd = (&raw const good).wrapping_byte_add(1);
    assert_eq!(code(start, size, odd), POEGP_ERROR_MISALIGNED);
    let odd = start.wrapping_add(4);
    assert_eq!(code(odd, size, &raw const good), POEGP_ERROR_MISALIGNED);
    for bytes in [0, size - 1] {
        assert_eq!(code(start, bytes, &raw const good), POEGP_ERROR_TOO_SMALL);
    }
    for (change, expected) in [
        (0, POEGP_FILTER_PERIOD),
        (1, POEGP_FILTER_RATE),
        (2, POEGP_FILTER_ACCELERATION),
        (3, POEGP_FILTER_BLEND),
    ] {
        for value in [f32::NAN, 0.0, -1.0, 1e9] {
            let mut settings = good;
            *[
                &mut settings.period_s,
                &mut settings.rate,
                &mut settings.acceleration,
                &mut settings.blend_s,
            ][change] = value;
            assert_eq!(code(start, size, &raw const settings), expected);
        }
    }
    // Not one of them has made a filter of it.
    assert!(!is_disengaged(start.cast()));
    let (made, filter) = make(start, size, &raw const good);
    assert_eq!((made, is_disengaged(filter)), (POEGP_OK, true));
    // SAFETY: refused before anything is written.
    let none = unsafe { poegp_filter_init(start.cast(), size, &raw const good, null_mut()) };
    assert_eq!(none, POEGP_ERROR_NULL);
    let inside = start.wrapping_add(64).cast();
    // SAFETY: the same.
    let inside = unsafe { poegp_filter_init(start.cast(), size, &raw const good, inside) };
    assert_eq!(inside, POEGP_ERROR_OVERLAP);
    // SAFETY: the same.
    let none = unsafe { poegp_filter_defaults(PERIOD, null_mut()) };
    assert_eq!(none, POEGP_ERROR_NULL);
}

#[test]
fn bad_filters_are_refused_and_the_answer_is_safe() {
    let cell = Cell::new(BLOB);
    let mut zeroed = FilterMemory([0; POEGP_FILTER_BYTES]);
    let raw = (&raw mut zeroed).cast::<Filter>();
    let mut given = COMMAND;
    given[2] = f32::NAN;
    for (filter, expected) in [
        (null_mut(), POEGP_ERROR_NULL),
        (raw.wrapping_byte_add(2), POEGP_ERROR_MISALIGNED),
        (raw, POEGP_ERROR_NOT_INITIALISED),
        // A model is no filter.
        (cell.model.cast(), POEGP_ERROR_OVERLAP),
    ] {
        let (code, answer) = command(cell.model, filter, &Asked::new(&given));
        assert_eq!((code, answer.status), (expected, POEGP_STATUS_BAD_INPUT));
        assert_eq!(answer.joints, [0.3, -0.2, 0.0, 0.1, 0.7, -0.5, 0.0, 0.0]);
        assert!(!is_disengaged(filter));
        let of_handle = if expected == POEGP_ERROR_OVERLAP {
            POEGP_ERROR_NOT_INITIALISED
        } else {
            expected
        };
        // SAFETY: refused before it is changed.
        let code = unsafe { poegp_filter_reset(filter) };
        assert_eq!(code, of_handle);
        let mut counts = FilterCounts {
            bad: 7,
            ..FilterCounts::default()
        };
        // SAFETY: the pointer to the answer is good.
        let code = unsafe { poegp_filter_counts(filter, &raw mut counts) };
        assert_eq!((code, counts), (of_handle, FilterCounts::default()));
    }
    // Nor is a filter a model: without one the command goes out.
    let (code, answer) = command(raw.cast(), cell.filter, &Asked::new(&COMMAND));
    assert_eq!(code, POEGP_ERROR_NOT_INITIALISED);
    assert_eq!(answer.status & POEGP_STATUS_NO_MODEL, POEGP_STATUS_NO_MODEL);
    assert_eq!(answer.joints[..6], COMMAND);
}

#[test]
fn bad_arguments_are_refused_and_the_last_joints_stay() {
    let cell = Cell::engaged(BLOB, &COMMAND);
    let last = cell.command(&COMMAND, true);
    let mut room = MaybeUninit::<[Commanded; 2]>::zeroed();
    let place = room.as_mut_ptr().cast::<Commanded>();
    let call = |joints, count, out| {
        // SAFETY: what cannot be used is refused before it is.
        unsafe { poegp_command(cell.model, cell.filter, joints, count, 1.0, 1, 1, out) }
    };
    let good = COMMAND.as_ptr();
    for (out, code) in [
        (null_mut(), POEGP_ERROR_NULL),
        (place.wrapping_byte_add(2), POEGP_ERROR_MISALIGNED),
        (cell.model.cast(), POEGP_ERROR_OVERLAP),
        (cell.filter.cast(), POEGP_ERROR_OVERLAP),
    ] {
        assert_eq!(call(good, 6, out), code);
    }
    assert_eq!(cell.counts().bad, 0);
    for (joints, code) in [
        (null(), POEGP_ERROR_NULL),
        (good.wrapping_byte_add(2), POEGP_ERROR_MISALIGNED),
    ] {
        assert_eq!(call(joints, 6, place), code);
        // SAFETY: zeroed, and written by the call.
        let answer = unsafe { place.read() };
        assert_eq!(answer.joints, last.joints);
        assert_ne!(answer.status & POEGP_STATUS_BAD_INPUT, 0);
    }
    let many = [0.25; 40];
    assert_eq!(call(many.as_ptr(), 40, place), POEGP_OK);
    assert_eq!(call(null(), 0, place), POEGP_OK);
    assert_eq!(cell.counts().bad, 4);
    // The filter has survived all of it.
    let answer = cell.command(&COMMAND, true);
    assert_eq!((answer.joints, answer.weight), (last.joints, 1.0));
    let counts = cell.filter.cast::<FilterCounts>().wrapping_add(1);
    // SAFETY: refused before it is written.
    let code = unsafe { poegp_filter_counts(cell.filter, counts) };
    assert_eq!(code, POEGP_ERROR_OVERLAP);
    // SAFETY: the same.
    let code = unsafe { poegp_filter_counts(cell.filter, null_mut()) };
    assert_eq!(code, POEGP_ERROR_NULL);
}

#[test]
fn whatever_comes_finite_joints_go() {
    let cell = Cell::new(BLOB);
    let mut dice = Dice(23);
    for _ in 0..20_000 {
        let mut joints: [f32; 9] = std::array::from_fn(|_| dice.within(-2.0, 2.0));
        if dice.is(3) {
            joints[(dice.next() % 9) as usize] = f32::from_bits(dice.next() as u32);
        }
        let asked = Asked {
            joints: &joints[..(if dice.is(4) { dice.next() % 10 } else { 6 }) as usize],
            payload_kg: if dice.is(3) {
                f32::from_bits(dice.next() as u32)
            } else {
                2.0
            },
            engage: dice.is(2),
            cycles: if dice.is(9) { dice.next() as u32 } else { 1 },
        };
        let (code, answer) = command(cell.model, cell.filter, &asked);
        assert_eq!(code, POEGP_OK);
        let rest = [
            answer.weight,
            answer.applied,
            answer.position_error,
            answer.rotation_error,
        ];
        for number in answer.joints.iter().chain(&rest) {
            assert!(number.is_finite(), "{answer:?}");
        }
        assert!((0.0..=1.0).contains(&answer.weight));
        assert!((0.0..=1.0).contains(&answer.applied));
    }
}

#[test]
fn a_command_may_be_answered_in_place() {
    let [cell, twin] = [BLOB, BLOB].map(|bytes| Cell::engaged(bytes, &COMMAND));
    let expected = twin.command(&COMMAND, true);
    let mut answer = expected;
    answer.joints[..6].copy_from_slice(&COMMAND);
    let place = &raw mut answer;
    let joints = place
        .cast::<f32>()
        .wrapping_byte_add(offset_of!(Commanded, joints));
    // SAFETY: six joints lie in the answer.
    let code = unsafe { poegp_command(cell.model, cell.filter, joints, 6, 1.0, 1, 1, place) };
    assert_eq!((code, answer), (POEGP_OK, expected));
}

#[test]
fn reset_forgets_all_but_settings_and_counts() {
    let cell = Cell::engaged(BLOB, &COMMAND);
    let mut bad = COMMAND;
    bad[0] = f32::NAN;
    cell.command(&bad, true);
    assert!(!cell.is_disengaged());
    // SAFETY: a filter, and no second thread.
    assert_eq!(unsafe { poegp_filter_reset(cell.filter) }, POEGP_OK);
    assert!(cell.is_disengaged());
    assert_eq!(cell.counts().bad, 1);
    assert_eq!(cell.command(&COMMAND, true).joints[..6], COMMAND);
    for _ in 0..LONG {
        cell.command(&COMMAND, true);
    }
    assert_eq!(
        cell.command(&COMMAND, true).joints,
        correct(cell.model, &COMMAND).joints
    );
}
