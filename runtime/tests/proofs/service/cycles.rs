//! The answers of a cycle: the bits of the model, or the unchanged command if nothing can correct it.

use poegp_protocol::link::{Query, Refusal, Request, Response, Trace};
use poegp_runtime::guard::status::Status;

use super::desk::{DEADLINE_TICKS, Desk, wire};
use super::known::{Known, assert_as_it_came, bits, piece, query};
use crate::arm::{Arm, Seen};

fn evaluate(desk: &mut Desk, query: &Query) -> poegp_protocol::link::Evaluation {
    match desk.ask_twice(&Request::Evaluate(query.clone())) {
        Response::Evaluation(evaluation) => evaluation,
        other => panic!("{other:?}"),
    }
}

fn correct(desk: &mut Desk, query: &Query) -> poegp_protocol::link::Corrected {
    match desk.ask_twice(&Request::Correct(query.clone())) {
        Response::Corrected(corrected) => corrected,
        other => panic!("{other:?}"),
    }
}

fn trace(desk: &mut Desk, query: &Query) -> Trace {
    match desk.ask_twice(&Request::Trace(query.clone())) {
        Response::Trace(trace) => trace,
        other => panic!("{other:?}"),
    }
}

#[test]
fn answers_are_those_of_the_runtime() {
    for known in Known::three() {
        let mut desk = Desk::default();
        known.install(&mut desk);
        for (place, payload_kg) in [0.0, 0.1, -0.7, 1.9, 2.5, -40.0]
            .into_iter()
            .zip([1.0, 4.0, 0.0, 9.0, 12.0, 1e4])
        {
            let joints: Vec<f32> = (0..known.joints)
                .map(|joint| place + 0.05 * joint as f32)
                .collect();
            let query = query(&joints, payload_kg);
            let answer = evaluate(&mut desk, &query);
            known.assert_evaluated(&query, &answer);
            assert_eq!(answer.ticks, 100);
            assert!((0.0..=1.0).contains(&answer.trust));
            let answer = correct(&mut desk, &query);
            known.assert_corrected(&query, &answer);
            assert_eq!(answer.ticks, 100);
        }
    }
}

#[test]
fn a_trace_shows_the_stages() {
    let mut arm = Arm::sound(3, 7);
    let known = Known::new(arm.clone());
    let mut desk = Desk::default();
    known.install(&mut desk);
    let query = query(&[0.1, 0.2, 0.3], 4.0);
    let mut seen = Seen::default();
    arm.model::<f32>()
        .evaluate_observed(&query.joints, 4.0, &mut seen);
    let trace = trace(&mut desk, &query);
    known.assert_evaluated(&query, &trace.evaluation);
    assert_eq!(trace.evaluation, evaluate(&mut desk, &query));
    let narrow = |values: &[f64]| -> Vec<f32> { values.iter().map(|x| *x as f32).collect() };
    assert_eq!(bits(&trace.mean), bits(&narrow(&seen.mean)));
    assert_eq!(bits(&trace.chain), bits(&narrow(&seen.chain)));
    assert_eq!(bits(&trace.sin_cos), bits(&narrow(&seen.motions)));
}

/// A trace takes longer than a command, so traces are refused from the first command to the end of the cycles.
#[test]
fn no_trace_delays_a_command() {
    let known = Known::new(Arm::sound(3, 7));
    let mut desk = Desk::default();
    known.install(&mut desk);
    let query = query(&[0.1, 0.2, 0.3], 4.0);
    let before = trace(&mut desk, &query).evaluation;
    let refused = desk.statistics().refused;
    let answer = desk.ask(&Request::Command(query.clone()));
    assert!(matches!(answer, Response::Commanded(_)));
    let answer = desk.ask(&Request::Trace(query.clone()));
    assert_eq!(answer, Response::Refused(Refusal::CyclesRunning));
    assert_eq!(desk.statistics().refused, refused + 1);
    assert_eq!(evaluate(&mut desk, &query), before);
    assert_eq!(desk.ask(&Request::StopCyclic), Response::CyclicStopped);
    assert_eq!(trace(&mut desk, &query).evaluation, before);
}

#[test]
fn without_a_model_the_command_comes_back() {
    let mut desk = Desk::default();
    for joints in [&[][..], &[0.5], &[0.1, -0.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0]] {
        let query = query(joints, 2.0);
        let answer = correct(&mut desk, &query);
        assert_as_it_came(&query, &answer, Status::NO_MODEL);
        assert_eq!(answer.blob_crc, 0);
        let answer = evaluate(&mut desk, &query);
        assert_eq!(
            (answer.blob_crc, answer.status),
            (0, Status::NO_MODEL.bits())
        );
        let identity = [1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0];
        assert_eq!(answer.pose, identity);
        assert_eq!(trace(&mut desk, &query).evaluation, answer);
    }
    let statistics = desk.statistics();
    assert_eq!((statistics.cycles, statistics.flagged), (18, 18));
    assert_eq!((statistics.uncorrected, statistics.limited), (6, 0));
}

#[test]
fn bad_input_comes_back() {
    for known in Known::three() {
        let mut desk = Desk::default();
        known.install(&mut desk);
        let good = vec![0.25; known.joints];
        let mut bad = vec![
            query(&[], 1.0),
            query(&good[1..], 1.0),
            query(&[0.5; 8], 1.0),
            query(&good, f32::NAN),
            query(&good, f32::INFINITY),
            query(&good, -1.0),
            query(&good, 1e9),
        ];
        for value in [f32::NAN, f32::NEG_INFINITY, f32::INFINITY, f32::MAX] {
            let mut joints = good.clone();
            joints[1] = value;
            bad.push(query(&joints, 1.0));
        }
        let expected = 2 * bad.len() as u32;
        for query in bad {
            // Compared number by number, because a NaN does not equal itself.
            let Response::Corrected(answer) = desk.ask(&Request::Correct(query.clone())) else {
                panic!()
            };
            assert_as_it_came(&query, &answer, Status::BAD_INPUT);
            assert_eq!(answer.blob_crc, known.blob_crc);
            known.assert_evaluated(&query, &evaluate(&mut desk, &query));
            desk.ask(&Request::Correct(query));
        }
        let statistics = desk.statistics();
        assert_eq!(statistics.uncorrected, expected);
        assert_eq!(statistics.flagged, 2 * expected);
    }
}

#[test]
fn the_bypass_lets_commands_pass() {
    let [known, ..] = Known::three();
    let mut desk = Desk::default();
    known.install(&mut desk);
    let usual = query(&[0.3, -0.4], 2.0);
    for on in [true, false, true] {
        let Response::Identity(identity) = desk.ask_twice(&Request::SetBypass { on }) else {
            panic!()
        };
        assert_eq!(identity.bypass, on);
        let before = desk.statistics().uncorrected;
        let answer = correct(&mut desk, &usual);
        if on {
            for query in [usual.clone(), query(&[], 1.0), query(&[7.0; 8], -3.0)] {
                let answer = correct(&mut desk, &query);
                assert_as_it_came(&query, &answer, Status::BYPASSED);
                assert_eq!(answer.blob_crc, known.blob_crc);
            }
            assert_eq!(desk.statistics().uncorrected, before + 8);
        } else {
            known.assert_corrected(&usual, &answer);
        }
        // The bypass does not change evaluated poses.
        known.assert_evaluated(&usual, &evaluate(&mut desk, &usual));
    }
    // The bypass survives a restart, but not a loss of power.
    assert_eq!(desk.ask_twice(&Request::Restart), Response::Restarting);
    let mut desk = desk.restarted();
    assert!(desk.identity().bypass);
    assert_as_it_came(&usual, &correct(&mut desk, &usual), Status::BYPASSED);
    let mut desk = Desk::start(desk.flash, false);
    known.assert_corrected(&usual, &correct(&mut desk, &usual));
}

#[test]
fn only_cyclic_requests_say_that_more_will_come() {
    let mut desk = Desk::default();
    let query = query(&[0.1], 0.0);
    let services = [
        Request::Identify,
        Request::ReadStatistics,
        Request::VerifyUpload,
        Request::SetBypass { on: false },
    ];
    let cyclic = [
        Request::Evaluate(query.clone()),
        Request::Correct(query.clone()),
        Request::Trace(query),
    ];
    for request in cyclic {
        for service in &services {
            desk.ask(service);
            assert!(!desk.is_running());
        }
        desk.ask(&request);
        assert!(desk.is_running());
        for service in &services {
            desk.ask(service);
            assert!(desk.is_running(), "a service does not end the cycle");
        }
        assert!(
            !desk.answers(&[5, 5, 0]).is_empty(),
            "noise is answered and does not end the cycle"
        );
        assert!(desk.is_running());
        assert_eq!(
            desk.ask_twice(&Request::StopCyclic),
            Response::CyclicStopped
        );
        assert!(!desk.is_running());
    }
    // Completed cycles feed a watchdog; stopping and services do not.
    assert_eq!(desk.completed().0, 3);
    assert_eq!(desk.statistics().cycles, 3);
}

#[test]
fn late_answers_are_counted() {
    let mut desk = Desk::default();
    let request = Request::Correct(query(&[0.1], 0.0));
    desk.ask(&request);
    let statistics = desk.statistics();
    // The clock is read twice around the computation and once at the end.
    assert_eq!(
        (statistics.max_ticks, statistics.max_latency_ticks),
        (100, 300)
    );
    assert_eq!(statistics.missed_deadlines, 0);
    desk.set_tick_step(DEADLINE_TICKS / 3);
    desk.ask(&request);
    assert_eq!(desk.statistics().missed_deadlines, 0);
    desk.set_tick_step(DEADLINE_TICKS / 3 + 1);
    desk.ask(&request);
    desk.ask(&Request::StopCyclic);
    desk.set_tick_step(1);
    desk.ask(&request);
    let statistics = desk.statistics();
    assert_eq!(statistics.missed_deadlines, 1);
    assert_eq!(
        (statistics.max_ticks, statistics.max_latency_ticks),
        (334, 1_002)
    );
    assert_eq!(statistics.cycles, 4);
}

/// While a blob is verified and written, the device answers corrections with the old model, in the middle of the service.
#[test]
fn services_do_not_hold_up_the_cycle() {
    let [old, new, _] = Known::three();
    let mut desk = Desk::default();
    old.install(&mut desk);
    new.upload(&mut desk);
    let query = query(&[0.3, -0.4], 2.0);
    let mut line = wire(1, &Request::CommitUpload);
    for sequence in 100..150 {
        line.extend(wire(sequence, &Request::Correct(query.clone())));
    }
    line.extend(wire(2, &piece(&new.bytes, 0, 20)));
    let answers = desk.answers(&line);
    assert_eq!(answers.len(), 52);
    let committed = |answer: &(u16, Response)| matches!(answer, (1, Response::Committed(_)));
    let place = answers.iter().position(committed).expect("committed");
    assert!(place > 20, "{place} corrections while flash was written");
    assert!(desk.completed().1 > 20);
    let mut corrected = 0;
    for (sequence, answer) in &answers {
        if let Response::Corrected(answer) = answer {
            old.assert_corrected(&query, answer);
            assert_eq!(*sequence, 100 + corrected, "answers out of order");
            corrected += 1;
        }
    }
    assert_eq!(corrected, 50);
}
