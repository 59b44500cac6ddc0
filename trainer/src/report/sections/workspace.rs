//! Where in the workspace the errors are: three projections, before and after, with arrows.

use maud::html;

use super::methods::keys;
use crate::held_out::HeldOutPose;
use crate::report::chart::{Axis, Plot, Series, plain, round_125};
use crate::report::{Evidence, HeldOutFacts, Number, Section};

/// Length of an arrow that 95 % of the errors stay below, as a share of the widest side.
const ARROW: f64 = 0.11;
/// Sides of a projection in units of the drawing, and the room that its labels take beside the plane.
const SIDE: f64 = 300.0;
const ROOM: (f64, f64) = (62.0, 50.0);

/// Three projections, before and after.
pub fn workspace(evidence: &Evidence, facts: &HeldOutFacts) -> Section {
    let both = evidence.before != evidence.after;
    let mut section = Section::new("workspace", "Where in the workspace").small_figures();
    section = section.text(html! {
        (keys(both)) ". Every arrow begins where a held-out pose was measured and shows the error there, longer than it is; "
        "x, y, z are the axes of the robot's base."
    });
    let (low, high) = extent(&evidence.after().poses);
    let widest = (0..3).map(|i| high[i] - low[i]).fold(0.0, f64::max);
    if !(widest > 0.0) {
        return section.missing("Not shown: all poses are at one place.");
    }
    let mut shown = vec![(Series::Before, evidence.before(), &facts.before, "before")];
    if both {
        shown.push((Series::After, evidence.after(), &facts.after, "after"));
    }
    for (series, method, facts, which) in shown {
        let p95 = facts.errors.position_mm.p95;
        let factor = round_125(ARROW * widest / p95.max(1e-9), false);
        for [u, v] in [[0, 1], [0, 2], [1, 2]] {
            let names = ["x", "y", "z"];
            let pad = 0.06 * widest;
            // One scale for both axes: the plane is as high as it has to be.
            let (width, height) = (high[u] - low[u] + 2.0 * pad, high[v] - low[v] + 2.0 * pad);
            let per_mm = (SIDE - ROOM.0) / width.max(height);
            let mut plot = Plot::new(
                Axis::linear(format!("{} (mm)", names[u]), low[u] - pad, high[u] + pad),
                Axis::linear(format!("{} (mm)", names[v]), low[v] - pad, high[v] + pad),
            )
            .sized(width * per_mm + ROOM.0, height * per_mm + ROOM.1);
            let place = |p: &HeldOutPose| [u, v].map(|i| 1e3 * p.position[i]);
            plot.arrows(
                series,
                method.poses.iter().map(|p| {
                    let [x, y] = place(p);
                    [
                        x,
                        y,
                        1e3 * factor * p.residual[u],
                        1e3 * factor * p.residual[v],
                    ]
                }),
            );
            let mean = facts.errors.position_mm.mean;
            section = section.figure(
                html! {
                    @if !both { "" } @else if which == "before" { "Before, " } @else { "After, " }
                    (names[u]) "–" (names[v]) ": mean "
                    (Number::mm(mean, format!("/held_out/{which}/position_mm/mean"))) " mm"
                },
                plot.render("Errors over the workspace"),
                &format!("Arrows are {} times as long as the error.", plain(factor)),
            );
        }
    }
    section.text(html! {
        "Arrows that all point one way in a region are a systematic error that the model has not learnt; arrows in all "
        "directions are noise of the instrument and of the arm."
    })
}

/// Smallest and largest measured coordinates in mm.
fn extent(poses: &[HeldOutPose]) -> ([f64; 3], [f64; 3]) {
    let fold = |start: f64, take: fn(f64, f64) -> f64| {
        [0, 1, 2].map(|i| poses.iter().map(|p| 1e3 * p.position[i]).fold(start, take))
    };
    (
        fold(f64::INFINITY, f64::min),
        fold(f64::NEG_INFINITY, f64::max),
    )
}
