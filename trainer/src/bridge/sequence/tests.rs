use super::*;

/// A session whose cycle time is known.
fn begun(cycle: u64) -> Sequence {
    let mut sequence = Sequence::new();
    assert_eq!(sequence.take(1_000), Order::First);
    for step in 1..=u64::from(LEARNED) {
        assert_eq!(sequence.cycle_ms(), None);
        assert_eq!(sequence.take(1_000 + step * cycle), Order::Next(1));
    }
    assert_eq!(sequence.cycle_ms(), Some(cycle));
    sequence
}

#[test]
fn cycles_of_both_lengths_are_counted() {
    for cycle in [4, 12] {
        let mut sequence = begun(cycle);
        let last = 1_000 + 10 * cycle;
        assert_eq!(sequence.take(last + 3 * cycle), Order::Next(3));
        assert_eq!(sequence.lost(), 2);
        assert_eq!(sequence.take(last + 3 * cycle), Order::Repeated);
        assert_eq!(sequence.take(last + cycle), Order::Late);
        assert_eq!(sequence.lost(), 1);
        assert_eq!(sequence.take(last + cycle), Order::RepeatedLate);
        assert_eq!(sequence.take(last), Order::RepeatedLate);
        assert_eq!(sequence.take(last + 4 * cycle), Order::Next(1));
        assert_eq!(sequence.lost(), 1);
    }
}

#[test]
fn a_gap_while_the_cycle_is_learned_is_lost_too() {
    let mut sequence = Sequence::new();
    let stamps = [0, 8, 12, 16, 20, 32, 36, 40, 44, 48, 52];
    for ipoc in stamps {
        sequence.take(ipoc);
    }
    assert_eq!(sequence.cycle_ms(), Some(4));
    assert_eq!(sequence.lost(), 52 / 4 + 1 - stamps.len() as u64);
}

/// One stamp from nowhere, and one between two cycles, change nothing; three in a row are another session.
#[test]
fn another_session_is_confirmed_first() {
    for start in [0, 500, 1_042, 90_000_000, u64::MAX - 40] {
        let mut sequence = begun(4);
        assert_eq!(sequence.take(start), Order::Stray, "{start}");
        assert_eq!(sequence.take(1_044), Order::Next(1));
        assert_eq!(sequence.take(start), Order::Stray);
        assert_eq!(sequence.take(start + 4), Order::Stray);
        assert_eq!(sequence.take(1_048), Order::Next(1));
        for step in 0..u64::from(CONFIRMED) - 1 {
            assert_eq!(sequence.take(start + 4 * step), Order::Stray);
        }
        assert_eq!(sequence.take(start + 8), Order::First);
        assert_eq!((sequence.cycle_ms(), sequence.lost()), (None, 0));
        assert_eq!(sequence.take(start + 12), Order::Next(1));
    }
}

#[test]
fn a_gap_of_a_hundred_cycles_is_the_longest() {
    let mut sequence = begun(4);
    assert_eq!(sequence.take(1_040 + 400), Order::Next(100));
    assert_eq!(sequence.take(1_440 + 404), Order::Stray);
    assert_eq!(sequence.lost(), 99);
}

#[test]
fn a_connection_that_loses_half_is_noticed() {
    let mut sequence = begun(4);
    let mut ipoc = 1_040;
    let mut advance = |sequence: &mut Sequence, packets: u64, step: u64| {
        for _ in 0..packets {
            ipoc += step;
            sequence.take(ipoc);
        }
        sequence.loses_many()
    };
    assert!(!advance(&mut sequence, 100, 8));
    assert!(advance(&mut sequence, 100, 12));
    assert!(advance(&mut sequence, 100, 8));
    assert!(!advance(&mut sequence, 100, 4));
}

/// After a silence in which every controller ends its session, the next packet begins another one, whatever its time stamp.
#[test]
fn an_ended_session_is_not_continued() {
    let mut sequence = Sequence::new();
    assert_eq!(sequence.take(1_000), Order::First);
    for ipoc in (1_004..1_100).step_by(4) {
        assert!(matches!(sequence.take(ipoc), Order::Next(_)));
    }
    sequence.end();
    assert_eq!(sequence.take(1_104), Order::First);
    assert_eq!(sequence.lost(), 0);
}
