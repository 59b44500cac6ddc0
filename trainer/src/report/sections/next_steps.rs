//! The next steps, for a reader who knows no statistics.

use maud::{Markup, html};

use crate::report::{Number, Section, sentence};
use poegp_calibration::validation::next_steps::{NextSteps, Step};

/// Returns the section with the steps in order of their gain, or with a sentence that none is worthwhile.
pub fn next_steps(found: Option<&NextSteps>) -> Section {
    let mut section = Section::new("next", "What to do next");
    let Some(found) = found else {
        return section.missing("Not shown: nothing was examined.");
    };
    section = section.block(html! {
        p { b { (found.verdict) "." } @if let Some(why) = &found.why { " " (sentence(why)) "." } }
    });
    if !found.steps.is_empty() {
        let steps = found.steps.iter().enumerate();
        section =
            section.block(html! { ol { @for (i, step) in steps { li { (line(i, step)) } } } });
    }
    let (Some(expected), Some(noise)) = (found.expected_mm, found.noise_mm) else {
        return section;
    };
    section.text(html! {
        "The numbers are forecasts. At a random new pose within the joint ranges measured so far, "
        "the model expects an error of " (Number::mm(expected, "/next_steps/expected_mm")) " mm on average; "
        (Number::mm(noise, "/next_steps/noise_mm")) " mm would remain with a perfect model, because the measurement \
                                                     itself "
        "scatters. A step is listed if it makes that error visibly smaller. “Spread over the joint ranges” means poses all over "
        "them, as " code { "trainer plan" } " writes them. Calibrate with the old and the new rows together."
    })
}

/// Returns the first step, for the first screen.
pub fn first_step(found: &NextSteps) -> Markup {
    html! {
        @match found.steps.first() {
            Some(step) => { (line(0, step)) }
            None => { (found.verdict) "." }
        }
    }
}

fn line(index: usize, step: &Step) -> Markup {
    let at = |name: &str| format!("/next_steps/steps/{index}/{name}");
    html! {
        (step.text)
        @if let (Some(before), Some(after)) = (step.before_mm, step.after_mm) {
            ": expected error " (Number::mm(before, at("before_mm"))) " mm → " b { (Number::mm(after, at("after_mm"))) " mm" }
        }
        "."
    }
}
