//! Whether the arm conforms to its tolerance, how certain that is, and who measured it with which instrument.

use maud::{Markup, html};
use poegp_calibration::blob::live_correction::{COMPLETE_MM, LiveCorrection};
use poegp_calibration::validation::conformity::budget::Contribution;
use poegp_calibration::validation::conformity::{
    Characteristic, Conformity, Evidence, LEAST_POSES, Verdict,
};
use poegp_calibration::validation::next_steps::NextSteps;
use poegp_calibration::validation::repeated_poses::STANDARD_CYCLES;

use crate::report::certificate::{Certificate, ListedPose};
use crate::report::sections::next_steps::first_step;
use crate::report::{Number, Section};

/// Number of repeated poses that are listed.
const LISTED: usize = 20;

const OF_POSITION: &str = "/certificate/conformity/position";
const OF_ROTATION: &str = "/certificate/conformity/orientation";

/// Lists warnings.
pub fn warning_list(warnings: &[String]) -> Markup {
    html! {
        ul class="warnings" {
            @for text in warnings { li { b { "Warning: " } (text.trim_end_matches('.')) "." } }
        }
    }
}

/// Returns the section that a customer reads first: the warnings, whether the arm is good enough, how certain that is, what
/// live corrections leave, and what to do next.
pub fn verdict(
    certificate: &Certificate,
    warnings: &[String],
    live: Option<&LiveCorrection>,
    next: Option<&NextSteps>,
) -> Section {
    let mut section = Section::new("verdict", "");
    if !warnings.is_empty() {
        section = section.block(warning_list(warnings));
    }
    let Some(conformity) = &certificate.conformity else {
        return section.missing(format!(
            "No verdict: fewer than {LEAST_POSES} poses that differ were held out."
        ));
    };
    let is_met = conformity.withheld.is_none();
    let lead = html! {
        p class="lead" {
            @match conformity.verdict {
                Some(Verdict::Conforms) => { b class="verdict conforms" { "The arm conforms. " } }
                Some(Verdict::DoesNotConform) => { b class="verdict fails" { "The arm does not conform. " } }
                Some(Verdict::Undecided) => { b class="verdict undecided" { "It cannot be decided whether the arm conforms. " } }
                None => {}
            }
            (sentence(&conformity.position, "position", OF_POSITION, is_met))
            @if let Some(rotation) = &conformity.orientation { " " (sentence(rotation, "rotation", OF_ROTATION, is_met)) }
        }
    };
    let both = [Some(&conformity.position), conformity.orientation.as_ref()];
    let tolerances = both.into_iter().flatten().filter_map(|c| c.tolerance);
    let are_two = tolerances.count() == 2;
    let coverage = Number::percent(conformity.coverage, "/certificate/conformity/coverage");
    let sure = html! {
        "How sure: "
        @match conformity.evidence {
            Evidence::HeldOutPoses => {
                "the error is estimated for all poses like the held-out ones; the range after ± contains \
                 the true value in "
                (coverage) " of 100 such calibrations. "
            }
            Evidence::Touches => { "in " (coverage) " of 100 such calibrations the true value is within the range \
            after ± or below it. " }
        }
        @match conformity.verdict {
            verdict if !is_met => {
                @if verdict.is_some() { "The whole range is within the tolerance, but a part of it" } @else { "A part of the range" }
                " is assumed, not measured. "
                (conformity.withheld.as_deref().unwrap_or_default())
            }
            Some(Verdict::Undecided) => {
                "The tolerance" @if are_two { " of one of them" } " lies within the range. More "
                (evidence(conformity)) " narrow it."
            }
            Some(Verdict::Conforms) => { "The whole range is within the tolerance." }
            Some(Verdict::DoesNotConform) => { "Even the lower end of the range is beyond the tolerance" @if are_two { " of one of them" } "." }
            None => { "State a tolerance (" (flags(conformity)) ") to get a verdict here." }
        }
    };
    section = section.block(lead).text(sure);
    if let Some(live) = live.filter(|live| !live.is_complete()) {
        section = section.text(live_correction(live));
    }
    // What is not known is stated in its own section.
    match next.filter(|next| next.expected_mm.is_some() || !next.steps.is_empty()) {
        Some(next) => section.text(html! { "What to do next: " (first_step(next)) }),
        None => section,
    }
}

/// Says what corrections in every cycle leave, which the errors of the model do not show.
fn live_correction(live: &LiveCorrection) -> Markup {
    let at = |name: &str| format!("/controller/live/{name}");
    html! {
        "These are errors of the model. A live correction, in every cycle, leaves larger errors near singularities, \
         where a complete one would move joints too fast: of poses over the whole trained ranges, "
        (Number::percent(live.complete, at("complete"))) " % have at most " (COMPLETE_MM) " mm, 95 % at most "
        (Number::mm(live.remaining_mm.p95, at("remaining_mm/p95"))) " mm, all at most "
        (Number::mm(live.remaining_mm.max, at("remaining_mm/max"))) " mm. Targets of robot programs are \
         corrected completely wherever no joint moves by more than 0.1 rad."
    }
}

/// Returns a sentence such as "95 of 100 poses are within 0.312 ± 0.058 mm; 0.400 mm are allowed."
fn sentence(found: &Characteristic, what: &str, at: &str, is_met: bool) -> Markup {
    let number = |value: f64, name: &str| Number::new(value, 3, format!("{at}/{name}"));
    html! {
        "95 of 100 " (what) "s are off by at most "
        (number(found.error, "error")) " ± " (number(found.expanded, "expanded")) " " (found.unit) "; "
        @match found.tolerance {
            Some(tolerance) => { (number(tolerance, "tolerance")) " " (found.unit) " are allowed." }
            None if !is_met => { "no tolerance of this size is shown to be met." }
            None => { "a tolerance of " (number(found.met, "met")) " " (found.unit) " would be met." }
        }
    }
}

/// Returns the section with the uncertainty budget, and with poses that were measured several times.
pub fn uncertainty_budget(certificate: &Certificate) -> Section {
    let mut section = Section::new("budget", "How certain the verdict is");
    let Some(conformity) = &certificate.conformity else {
        return section.missing("Too few poses were held out for an uncertainty.");
    };
    let poses = Number::count(conformity.position.poses, format!("{OF_POSITION}/poses"));
    section = section.text(html! {
        @match conformity.evidence {
            Evidence::HeldOutPoses => {
                "The error that 95 of 100 poses do not exceed is estimated from " (poses) " different poses only, measured by an \
                 instrument that has errors of its own. "
            }
            Evidence::Touches => {
                "No poses were held out. The error that 95 of 100 poses do not exceed is computed for " (poses) " poses over \
                 the work volume, after the best registration of base and tool, from what the touches do not determine. "
            }
        }
        "The budget adds these sources (GUM, JCGM 100:2008). The arm conforms if the error plus \
         the expanded uncertainty is within the tolerance"
        @if conformity.evidence == Evidence::Touches { ", unless a part of it is assumed" }
        ". It does not conform if the error minus the expanded uncertainty is \
         beyond it. Between the two, nothing can be decided (ISO 14253-1)."
    });
    let is_met = conformity.withheld.is_none();
    section = budget(
        section,
        "Position",
        (&conformity.position, OF_POSITION),
        is_met,
    );
    if let Some(rotation) = &conformity.orientation {
        section = budget(section, "Rotation", (rotation, OF_ROTATION), is_met);
    }
    repeated(section, &certificate.repeated_poses)
}

/// Returns the flags that state a tolerance.
fn flags(conformity: &Conformity) -> &'static str {
    match conformity.evidence {
        Evidence::HeldOutPoses => "--tolerance-mm, --tolerance-mrad",
        Evidence::Touches => "--tolerance-mm",
    }
}

/// Returns what narrows the range of the uncertainty.
fn evidence(conformity: &Conformity) -> &'static str {
    match conformity.evidence {
        Evidence::HeldOutPoses => "poses that are not trained on",
        Evidence::Touches => "touches",
    }
}

fn budget(
    section: Section,
    what: &str,
    (found, at): (&Characteristic, &str),
    is_met: bool,
) -> Section {
    let number = |value: f64, name: &str| Number::new(value, 4, format!("{at}/{name}"));
    let row = |(i, c): (usize, &Contribution)| {
        let at = format!("{at}/budget/{i}");
        vec![
            html! { (c.source.name()) span class="basis" { (c.basis) } },
            html! {
                @match c.standard_uncertainty {
                    Some(u) => { (Number::new(u, 4, format!("{at}/standard_uncertainty"))) }
                    None => { "–" }
                }
            },
            html! { @if c.standard_uncertainty.is_some() { (Number::percent(c.share, format!("{at}/share"))) " %" } @else { "–" } },
            html! { (format!("{:?}", c.evaluation)) },
            html! { (c.distribution) },
        ]
    };
    let uncertainty = format!("standard uncertainty ({})", found.unit);
    let header = [what, &uncertainty, "share", "type", "distribution"];
    section
        .table(&header, found.budget.iter().enumerate().map(row).collect())
        .text(html! {
            "Error " (number(found.error, "error")) " " (found.unit)
            ", combined standard uncertainty " (number(found.combined, "combined")) " " (found.unit)
            ", expanded uncertainty " (number(found.expanded, "expanded")) " " (found.unit)
            " with a coverage factor of " (Number::new(found.coverage_factor, 2, format!("{at}/coverage_factor")))
            @if let Some(freedom) = found.degrees_of_freedom.filter(|freedom| *freedom < 1e4) {
                " (" (Number::new(freedom, 0, format!("{at}/degrees_of_freedom"))) " degrees of freedom)"
            }
            @if is_met {
                ". The smallest tolerance that would be met is " b { (number(found.met, "met")) " " (found.unit) } "."
            } @else { ". A part of this is assumed: no tolerance of this size is shown to be met." }
        })
}

/// Adds accuracy and repeatability of repeated poses (ISO 9283).
fn repeated(section: Section, poses: &[ListedPose]) -> Section {
    if poses.is_empty() {
        return section.missing(
            "Accuracy and repeatability (ISO 9283) are not shown: no pose was measured several times.",
        );
    }
    let row = |(i, pose): (usize, &ListedPose)| {
        let at = |name: &str| format!("/certificate/repeated_poses/{i}/{name}");
        let found = &pose.found;
        let three = |values: &[f64; 3], name: &str| {
            let number = |axis: usize| Number::mm(values[axis], at(&format!("{name}/{axis}")));
            html! { (number(0)) ", " (number(1)) ", " (number(2)) }
        };
        let turned = |values: &Option<[f64; 3]>, name: &str| {
            html! { @match values { Some(values) => { (three(values, name)) } None => { "–" } } }
        };
        vec![
            html! { (pose.file) " line " (Number::count(pose.line, at("line"))) },
            html! { (Number::count(found.cycles, at("cycles"))) },
            html! { (Number::mm(found.position_accuracy_mm, at("position_accuracy_mm"))) },
            three(
                &found.position_accuracy_axes_mm,
                "position_accuracy_axes_mm",
            ),
            html! { (Number::mm(found.position_repeatability_mm, at("position_repeatability_mm"))) },
            turned(
                &found.orientation_accuracy_mrad,
                "orientation_accuracy_mrad",
            ),
            turned(
                &found.orientation_repeatability_mrad,
                "orientation_repeatability_mrad",
            ),
        ]
    };
    let header = [
        "pose",
        "cycles",
        "AP (mm)",
        "AP x, y, z (mm)",
        "RP (mm)",
        "AP a, b, c (mrad)",
        "RP a, b, c (mrad)",
    ];
    let rows = poses.iter().enumerate().take(LISTED).map(row).collect();
    let fewest = poses.iter().map(|p| p.found.cycles).min().unwrap_or(0);
    section
        .text(html! {
            "Accuracy AP and repeatability RP of ISO 9283 at the poses that were measured several times, relative to \
             the pose that the model predicts. "
            @if fewest < STANDARD_CYCLES { "The standard asks for " (STANDARD_CYCLES) " cycles at each; here there are as few as " (fewest) ". " }
            @if poses.len() > LISTED { "The first " (LISTED) " of " (poses.len()) " are listed." }
        })
        .table(&header, rows)
}

/// Returns the section on who measured with which instrument, and which statements are missing.
pub fn record(certificate: &Certificate, serial_number: &str) -> Section {
    let (instrument, record) = (&certificate.instrument, &certificate.record);
    let text = |value: &Option<String>| value.clone().unwrap_or_else(|| "not stated".to_owned());
    let expanded = |value: Option<f64>, unit: &str| match value {
        Some(value) => format!("{value} {unit} (k = 2)"),
        None => "not stated".to_owned(),
    };
    let temperature = match record.temperature_c {
        Some(value) => format!("{value} °C"),
        None => "not stated".to_owned(),
    };
    let serial = match serial_number {
        "" => "not stated".to_owned(),
        number => number.to_owned(),
    };
    let section = Section::new("record", "Who measured, and with which instrument").block(html! {
        dl {
            dt { "robot's serial number" } dd { (serial) }
            dt { "instrument" } dd { (text(&instrument.name)) }
            dt { "its certificate" } dd { (text(&instrument.certificate)) }
            dt { "its uncertainty of a position" } dd { (expanded(instrument.expanded_uncertainty_mm, "mm")) }
            @if let Some(value) = instrument.expanded_uncertainty_mrad {
                dt { "its uncertainty of a rotation" } dd { (expanded(Some(value), "mrad")) }
            }
            dt { "operator" } dd { (text(&record.operator)) }
            dt { "site" } dd { (text(&record.site)) }
            dt { "temperature" } dd { (temperature) }
            @if let Some(sum) = &certificate.program_sha256 { dt { "SHA-256 of the program" } dd class="hash" { (sum) } }
        }
    });
    match certificate.missing.is_empty() {
        true => section,
        false => section.missing(format!(
            "Missing: {}. State it in a project file, under [instrument], [record] and [robot].",
            certificate.missing.join(", ")
        )),
    }
}

/// Returns the verdict as text for a terminal; `None` without a tolerance.
pub fn line(conformity: &Conformity) -> Option<String> {
    let verdict = match conformity.verdict? {
        Verdict::Conforms => "conforms",
        Verdict::Undecided => "undecided",
        Verdict::DoesNotConform => "does not conform",
    };
    let poses = match conformity.evidence {
        Evidence::HeldOutPoses => "poses like the held-out ones",
        Evidence::Touches => "poses",
    };
    let of = |found: &Characteristic| {
        let tolerance = found.tolerance?;
        Some(format!(
            "95 of 100 {poses} within {:.3} ± {:.3} {unit}, {:.3} {unit} allowed",
            found.error,
            found.expanded,
            tolerance,
            unit = found.unit
        ))
    };
    let both = [Some(&conformity.position), conformity.orientation.as_ref()];
    let both: Vec<String> = both.into_iter().flatten().filter_map(of).collect();
    let withheld = conformity.withheld.as_ref();
    let withheld = withheld.map_or_else(String::new, |text| {
        format!("; a part of this is assumed, not measured: {text}")
    });
    Some(format!("{verdict} ({}{withheld})", both.join("; ")))
}
