//! Invalid arguments are refused, and finite joints come out whatever comes in.

use super::*;

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
    // None of these calls has made the memory a filter.
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
        // A model is not a filter.
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
    // A filter is not a model either: without a model the command comes back.
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
    for (joints, count) in [
        (many.as_ptr(), 40),
        (many.as_ptr(), 9),
        (null(), 0),
        (good, 5),
        (good, 1),
    ] {
        assert_eq!(call(joints, count, place), POEGP_ERROR_JOINTS, "{count}");
        // SAFETY: written by the call.
        let answer = unsafe { place.read() };
        assert_eq!(answer.joints, last.joints, "{count}");
        assert_ne!(answer.status & POEGP_STATUS_BAD_INPUT, 0);
    }
    // Fewer joints that cannot be read hold all six, too.
    assert_eq!(call(null(), 5, place), POEGP_ERROR_NULL);
    // SAFETY: written by the call.
    assert_eq!(unsafe { place.read() }.joints, last.joints);
    assert_eq!(cell.counts().bad, 8);
    // The filter is still usable afterwards.
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

/// Switched off or without a model, no other number of joints than before leaves a joint out.
#[test]
fn another_number_of_joints_is_held_when_off_too() {
    let cell = Cell::engaged(BLOB, &COMMAND);
    for _ in 0..LONG {
        cell.command(&COMMAND, false);
    }
    assert!(cell.is_disengaged());
    for model in [cell.model, null_mut()] {
        for count in [0, 1, 5] {
            let asked = Asked {
                engage: false,
                ..Asked::new(&COMMAND[..count])
            };
            let (code, answer) = command(model, cell.filter, &asked);
            assert_ne!(code, POEGP_OK);
            assert_eq!(answer.joints[..6], COMMAND, "{count}");
        }
    }
    // An arm of five joints under a model of six, not corrected: its commands pass.
    let five = Cell::new(BLOB);
    for step in [0.0, 0.1, 0.2] {
        let joints: [f32; 5] = std::array::from_fn(|i| COMMAND[i] + step);
        let asked = Asked {
            engage: false,
            ..Asked::new(&joints)
        };
        let (code, answer) = command(five.model, five.filter, &asked);
        assert_eq!(code, POEGP_ERROR_JOINTS);
        assert_eq!(answer.joints[..5], joints);
        let (code, held) = command(five.model, five.filter, &Asked::new(&joints));
        assert_eq!((code, held.joints), (POEGP_ERROR_JOINTS, answer.joints));
    }
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
        let fits = asked.joints.len() == 6;
        assert_eq!(code, if fits { POEGP_OK } else { POEGP_ERROR_JOINTS });
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
