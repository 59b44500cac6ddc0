//! Errors in the order of the rows, and errors by session.

use maud::html;

use crate::report::chart::{Axis, Brush, Plot, Series, boxes};
use crate::report::sections::poses::left_out;
use crate::report::sections::{BOX, boxes_of, mean_and_error};
use crate::report::{HeldOutSummary, Number, ReportData, Section};

/// Least number of rows of the running median, and below it the divisor that makes it a share of all rows.
const WINDOW: usize = 7;
const WINDOW_SHARE: usize = 15;
/// Largest number of sessions and files that are separated by lines.
const SEPARATED: usize = 8;

/// Returns the section with errors in row order, a running median, and boxes by session, target or file.
pub fn time(evidence: &ReportData, summary: &HeldOutSummary) -> Section {
    let errors = evidence.calibrated().errors();
    let n = errors.len();
    let mut section = Section::new("time", "Error over time");
    if n < 3 * WINDOW {
        return section.missing(format!(
            "Not shown: {n} poses are too few to see a trend over the measurement."
        ));
    }
    let mut plot = Plot::new(
        Axis::linear("held-out pose, in the order of the rows", 0.0, n as f64),
        Axis::errors("position error (mm)", &errors),
    );
    let drawn = evidence.drawn();
    let at = |(row, i): (usize, &usize)| (row, (*i as f64 + 0.5, errors[*i]));
    plot.poses(
        Series::Calibrated,
        Brush::Range,
        drawn.iter().enumerate().map(at),
    );
    let window = WINDOW.max(n / WINDOW_SHARE);
    let middle = |i: usize| {
        let from = i.saturating_sub(window / 2).min(n - window);
        let mut part = errors[from..from + window].to_vec();
        part.sort_by(f64::total_cmp);
        poegp_calibration::numeric::statistics::percentile(&part, 0.5)
    };
    let step = (n / 150).max(1);
    let line: Vec<(f64, f64)> = (0..n)
        .step_by(step)
        .map(|i| (i as f64 + 0.5, middle(i)))
        .collect();
    plot.line(Series::Reference, &line, false);
    let part = |row: &crate::report::Row| format!("{}\n{}", row.file, row.tool);
    let pairs = evidence.rows.windows(2).enumerate();
    let changes: Vec<usize> = pairs
        .filter(|(_, pair)| part(&pair[0]) != part(&pair[1]))
        .map(|(i, _)| i + 1)
        .collect();
    for row in changes.iter().filter(|_| changes.len() < SEPARATED) {
        plot.upright(Series::Other, *row as f64, "");
    }
    let third = n / 3;
    let (first, last) = (
        mean_and_error(&errors[..third]),
        mean_and_error(&errors[n - third..]),
    );
    let change = last.0 - first.0;
    let steady = change.abs() < 2.5 * first.1.hypot(last.1);
    section = section.figure(
        html! {
            @if steady { "The errors stay level: " } @else if change > 0.0 { "The rows at the end are worse: " }
            @else { "The rows at the beginning are worse: " }
            (format!("{:.3}", first.0)) " mm on average in the first third, " (format!("{:.3}", last.0))
            " mm in the last"
        },
        plot.render("Position errors in the order of the rows"),
        &format!(
            "Dashed: running median of {window} poses. A slope means that instrument, target or arm moved or warmed \
             up; with reference points in the file --correct-drift removes the instrument's part.{}",
            left_out(n)
        ),
    );
    let (parts, of, name, known) = if summary.tools.len() > 1 {
        let parts = evidence.parts(|row| row.tool.clone());
        (parts, "tools", "session or target", &summary.tools)
    } else if summary.files.len() > 1 {
        let parts = evidence.parts(|row| row.file.clone());
        (parts, "files", "file", &summary.files)
    } else {
        return section.missing(
            "There is one session only: whether a new mounting of the target changes anything cannot be seen in these data.",
        );
    };
    let drawn = boxes_of(&parts, "", &errors);
    let mean = |i: usize| known[i].errors.position_mm.mean;
    let worst = (0..known.len()).max_by(|a, b| mean(*a).total_cmp(&mean(*b)));
    let best = (0..known.len()).min_by(|a, b| mean(*a).total_cmp(&mean(*b)));
    let (worst, best) = (worst.unwrap_or(0), best.unwrap_or(0));
    let at = |i: usize| format!("/held_out/{of}/{i}/position_mm/mean");
    section.figure(
        html! {
            "By " (name) ": mean errors from " (Number::mm(mean(best), at(best))) " to " (Number::mm(mean(worst), at(worst))) " mm"
        },
        boxes("position error (mm), held out", &drawn, "Box plots of the position error by session"),
        BOX,
    )
}
