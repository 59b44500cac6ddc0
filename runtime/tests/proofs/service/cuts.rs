//! Cuts power at every flash operation during a request. After the restart the device runs the old or the new model.
//!
//! The tests of the store do the same for more kinds of flash and more states; these tests use the whole device.

use std::cell::RefCell;
use std::rc::Rc;

use poegp_protocol::link::{Request, Response};

use super::desk::{Desk, Flash, flash};
use super::known::{Known, query};
use super::nor::Cut;

/// Prepares a device over `prepared`, sends the request, and cuts power at every operation in every way. Returns the number of
/// cuts. `may_run` has the model before the request and the one after it.
fn cut_everywhere(
    prepared: &Flash,
    before: impl Fn(&mut Desk),
    request: &Request<'_>,
    may_run: [&Known; 2],
) -> u32 {
    let question = query(&[0.3, -0.4], 2.0);
    let mut cuts = 0;
    for cut in Cut::ALL {
        for operation in 0.. {
            let flash = Rc::new(RefCell::new(prepared.clone()));
            let mut desk = Desk::start(flash.clone(), false);
            before(&mut desk);
            flash.borrow_mut().cut_at(operation, cut);
            let done = !matches!(desk.ask(request), Response::Refused(_));
            let was_cut = flash.borrow().is_off();
            assert!(was_cut || done, "{operation} {cut:?}");
            // As long as there is power, corrections continue whatever the flash reports.
            let old_goes_on = desk.ask(&Request::Correct(question.clone()));
            assert!(matches!(old_goes_on, Response::Corrected(answer) if answer.blob_crc != 0));

            flash.borrow_mut().restart();
            let mut desk = Desk::start(flash, false);
            let Response::Corrected(answer) = desk.ask(&Request::Correct(question.clone())) else {
                panic!()
            };
            let runs = may_run
                .iter()
                .position(|known| known.blob_crc == answer.blob_crc);
            let runs = runs.unwrap_or_else(|| {
                panic!("neither the old nor the new model runs, at {operation} {cut:?}")
            });
            may_run[runs].assert_corrected(&question, &answer);
            assert!(
                !done || runs == 1,
                "a completed request was lost, at {operation} {cut:?}"
            );
            // The interrupted request can be repeated.
            if runs == 0 {
                before(&mut desk);
                let again = desk.ask(request);
                assert!(!matches!(again, Response::Refused(_)), "{again:?}");
                assert_eq!(desk.restarted().active(), Some(may_run[1].blob_crc));
            }
            if !was_cut {
                break;
            }
            cuts += 1;
        }
    }
    cuts
}

/// Returns a flash in which `models` were installed one after the other.
fn used(models: &[&Known]) -> Flash {
    let flash = flash();
    let mut desk = Desk::start(flash.clone(), false);
    for known in models {
        known.install(&mut desk);
    }
    let flash = flash.borrow();
    flash.clone()
}

#[test]
fn power_fails_at_every_operation_of_a_commit() {
    let [old, new, third] = Known::three();
    let upload = |desk: &mut Desk| {
        new.upload(desk);
    };
    let mut cuts = 0;
    for prepared in [used(&[&old]), used(&[&third, &old])] {
        cuts += cut_everywhere(&prepared, upload, &Request::CommitUpload, [&old, &new]);
    }
    // Also if the model was activated first.
    let activate = |desk: &mut Desk| {
        new.upload(desk);
        desk.ask(&new.activate());
    };
    let prepared = used(&[&third, &old]);
    cuts += cut_everywhere(&prepared, activate, &Request::CommitUpload, [&old, &new]);
    println!("{cuts} cuts");
    assert!(cuts > 3_000);
}

#[test]
fn power_fails_at_every_operation_of_a_roll_back() {
    let [old, new, third] = Known::three();
    let nothing = |_: &mut Desk| {};
    // Heads with free records and, after many rounds, without.
    let mut cuts = 0;
    let mut prepared = used(&[&third, &old, &new]);
    for turn in 0..24 {
        let (from, to) = if turn % 2 == 0 {
            (&new, &old)
        } else {
            (&old, &new)
        };
        cuts += cut_everywhere(&prepared, nothing, &from.roll_back(), [from, to]);
        let flash = Rc::new(RefCell::new(prepared));
        let mut desk = Desk::start(flash.clone(), false);
        desk.ask(&from.roll_back());
        prepared = flash.borrow().clone();
    }
    println!("{cuts} cuts");
    assert!(cuts > 500);
}
