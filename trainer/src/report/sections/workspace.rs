//! Errors in the workspace: three projections, before and after, with mean errors as arrows.

use maud::{Markup, html};

use crate::report::chart::{Axis, Brush, Plot, Series, plain};
use crate::report::sections::cubes::{self, Cube, Cubes};
use crate::report::sections::methods::keys;
use crate::report::sections::poses::left_out;
use crate::report::{HeldOutSummary, Number, ReportData, Section, capitalised, rounded};
use poegp_calibration::validation::held_out::HeldOutPose;

/// Length of the longest arrow, as a share of the side of a square.
const ARROW: f64 = 2.0;
/// Number of cubes that are listed.
const LISTED: usize = 3;
/// Side of a drawing, and below it the part of width and height that its labels take.
const SIDE: f64 = 300.0;
const LABELS: (f64, f64) = (66.0, 50.0);
/// Margin around the poses, as a share of the widest side.
const MARGIN: f64 = 0.06;
/// The views: the two visible axes, and the direction of view.
const VIEWS: [(usize, usize, &str); 3] = [
    (0, 1, "from above"),
    (0, 2, "from the side"),
    (1, 2, "from the front"),
];
/// Least number of poses for a statement about neighbours.
const FEWEST: usize = 20;
/// Mean cosine between neighbours' errors above which the errors are called systematic.
const SYSTEMATIC: f64 = 0.3;

/// Returns the section with three projections, before and after.
pub fn workspace(evidence: &ReportData, summary: &HeldOutSummary) -> Section {
    let both = evidence.nominal != evidence.calibrated;
    let section = Section::new("workspace", "Where in the workspace").small_figures();
    let (low, high) = extent(&evidence.calibrated().poses);
    let widest = (0..3).map(|i| high[i] - low[i]).fold(0.0, f64::max);
    if widest.is_nan() || widest <= 0.0 {
        return section.missing("Not shown: all poses are at one place.");
    }
    let poses = &evidence.calibrated().poses;
    let map = Map {
        low,
        high,
        widest,
        squares: VIEWS.map(|(u, v, _)| Cubes::of_view([u, v], poses, widest)),
        cubes: Cubes::new(poses, widest),
        drawn: evidence.drawn(),
    };
    let mut section = section
        .text(html! {
            (keys(both)) ". Dots are poses, where they were measured; x, y, z are the axes of the robot's base. Each view is "
            "divided into squares. An arrow is the mean error of the poses of a square, through the whole depth: from where the "
            "model says that the tool is to where it was measured, enlarged. Errors that the poses share remain in \
            the arrow; noise averages "
            "out. A square with fewer than " (cubes::FEWEST) " poses has no arrow."
            (left_out(evidence.rows.len()))
        })
        .answers()
        .text(neighbours(evidence));
    let calibrated = (
        Series::Calibrated,
        evidence.calibrated(),
        &summary.calibrated,
        "calibrated",
    );
    let nominal = (
        Series::Nominal,
        evidence.nominal(),
        &summary.nominal,
        "nominal",
    );
    let shown = both.then_some(nominal).into_iter().chain([calibrated]);
    for (series, method, summary, which) in shown {
        let factor = map.enlargement(&method.poses);
        for (view, squares) in map.squares.iter().enumerate() {
            let (_, _, from) = VIEWS[view];
            let mean = summary.errors.position_mm.mean;
            section = section.figure(
                html! {
                    (capitalised(which)) ", " (from) ": "
                    (Number::mm(mean, format!("/held_out/{which}/position_mm/mean"))) " mm on average"
                },
                map.plot(view, series, &method.poses, factor)
                    .render(&format!("Errors over the workspace {which}, {from}")),
                &format!(
                    "Arrows are {} times as long as the error; squares have sides of {} mm.",
                    plain(factor),
                    plain(squares.side)
                ),
            );
        }
    }
    listed(section, evidence, &map.cubes)
}

/// The workspace, which all figures divide in the same way. Lengths are in mm.
struct Map {
    /// Lower and upper ends of the poses.
    low: [f64; 3],
    high: [f64; 3],
    /// Longest side of the workspace.
    widest: f64,
    /// Squares of each of the [`VIEWS`].
    squares: [Cubes; 3],
    cubes: Cubes,
    /// Indices of the poses that are drawn as dots.
    drawn: Vec<usize>,
}

impl Map {
    /// Returns how many times as long as the errors their arrows are.
    fn enlargement(&self, poses: &[HeldOutPose]) -> f64 {
        let lengths = VIEWS
            .iter()
            .zip(&self.squares)
            .flat_map(|((u, v, _), view)| {
                let errors = view.cubes.iter().map(|c| c.mean_error(poses));
                errors.map(|e| e.vector[*u].hypot(e.vector[*v]) / view.side)
            });
        one_digit(ARROW / lengths.fold(1e-9, f64::max))
    }

    /// Draws the poses in one of the [`VIEWS`], with the errors of one model as arrows that are `factor` times as long.
    fn plot(&self, view: usize, series: Series, poses: &[HeldOutPose], factor: f64) -> Plot {
        let (u, v, _) = VIEWS[view];
        let side = self.widest * (1.0 + 2.0 * MARGIN);
        let (across, up) = (SIDE - LABELS.0, SIDE - LABELS.1);
        let names = ["x", "y", "z"];
        // One scale for both axes and all views: a unit is as many mm along as across.
        let axis = |i: usize, length: f64| {
            let middle = 0.5 * (self.low[i] + self.high[i]);
            Axis::linear(
                format!("{} (mm)", names[i]),
                middle - 0.5 * length,
                middle + 0.5 * length,
            )
        };
        let least = across.min(up);
        let mut plot =
            Plot::new(axis(u, side * across / least), axis(v, side * up / least)).sized(SIDE, SIDE);
        let dot = |(row, i): (usize, &usize)| {
            let [x, y] = [u, v].map(|k| 1e3 * poses[*i].position[k]);
            (row, (x, y))
        };
        plot.poses(
            Series::Other,
            Brush::Rectangle,
            self.drawn.iter().enumerate().map(dot),
        );
        for square in &self.squares[view].cubes {
            let error = square.mean_error(poses);
            let [x, y] = [u, v].map(|i| square.position[i]);
            let [dx, dy] = [u, v].map(|i| factor * error.vector[i]);
            let n = square.members.len();
            let title = format!("{n} poses: {:.3} mm on average", error.length);
            plot.arrow(series, [x, y, dx, dy], &title);
        }
        if let Some(i) = self.cubes.by_error(poses).first().copied() {
            let low = [u, v].map(|k| self.cubes.cubes[i].low[k]);
            let high = low.map(|x| x + self.cubes.side);
            plot.frame(
                Series::Reference,
                (low[0], low[1]),
                (high[0], high[1]),
                "largest",
            );
        }
        plot
    }
}

/// Adds the cubes with the largest mean errors, in text and in a table.
fn listed(section: Section, evidence: &ReportData, cubes: &Cubes) -> Section {
    let both = evidence.nominal != evidence.calibrated;
    let (before, after) = (&evidence.nominal().poses, &evidence.calibrated().poses);
    let order = cubes.by_error(after);
    let Some(first) = order.first().map(|i| &cubes.cubes[*i]) else {
        return section.missing(format!(
            "No cube has {} poses: nothing can be averaged over a part of the workspace.",
            cubes::FEWEST
        ));
    };
    let range = |cube: &Cube, i: usize| {
        let [low, high] = [cube.low[i], cube.low[i] + cubes.side].map(|x| rounded(x, 0));
        html! { (low) " … " (high) }
    };
    let error = first.mean_error(after);
    let certain = error.length > 3.0 * error.standard_error;
    let row = |i: &usize| {
        let cube = &cubes.cubes[*i];
        let error = cube.mean_error(after);
        let ranges = (0..3).map(|k| range(cube, k));
        let mut fields: Vec<Markup> = ranges.collect();
        fields.push(html! { (cube.members.len()) });
        fields.extend(error.vector.map(|x| html! { (rounded(x, 3)) }));
        fields.push(html! { (rounded(error.length, 3)) " ± " (rounded(error.standard_error, 3)) });
        if both {
            fields.push(html! { (rounded(cube.mean_error(before).length, 3)) });
        }
        fields
    };
    let mut header = vec![
        "x (mm)",
        "y (mm)",
        "z (mm)",
        "poses",
        "error x (mm)",
        "error y (mm)",
        "error z (mm)",
        "length (mm)",
    ];
    if both {
        header.push("before (mm)");
    }
    section
        .text(html! {
            "Over cubes with sides of " (plain(cubes.side)) " mm the mean error is largest at x " (range(first, 0)) ", y " (range(first, 1)) ", z " (range(first, 2)) " mm: "
            b class="calibrated" { (rounded(error.length, 3)) " ± " (rounded(error.standard_error, 3)) " mm" }
            " over " (first.members.len()) " poses, mostly along " (error.direction()) " (± is one standard error; framed as “largest”). "
            @if certain { "This is statistically significant." } @else { "This could be chance." }
        })
        .table(&header, order.iter().take(LISTED).map(row).collect())
}

/// Returns a sentence on whether errors of neighbouring poses point the same way: systematic errors could still be learnt,
/// noise could not.
fn neighbours(evidence: &ReportData) -> Markup {
    let agreement = |poses: &[HeldOutPose]| -> Option<f64> {
        let distance = |a: &HeldOutPose, b: &HeldOutPose| -> f64 {
            (0..3)
                .map(|i| (a.position[i] - b.position[i]).powi(2))
                .sum()
        };
        let length =
            |p: &HeldOutPose| -> f64 { p.residual[..3].iter().map(|x| x * x).sum::<f64>().sqrt() };
        let cosine = |(i, a): (usize, &HeldOutPose)| -> Option<f64> {
            let others = poses.iter().enumerate().filter(|(j, _)| *j != i);
            let nearest = others.map(|(_, b)| b);
            let b = nearest.min_by(|b, c| distance(a, b).total_cmp(&distance(a, c)))?;
            let product: f64 = (0..3).map(|k| a.residual[k] * b.residual[k]).sum();
            Some(product / (length(a) * length(b))).filter(|c| c.is_finite())
        };
        let all: Vec<f64> = poses.iter().enumerate().filter_map(cosine).collect();
        (all.len() >= FEWEST).then(|| all.iter().sum::<f64>() / all.len() as f64)
    };
    let Some(after) = agreement(&evidence.calibrated().poses) else {
        return html! { "There are too few poses to say whether errors of neighbours agree." };
    };
    let verdict = if after > SYSTEMATIC {
        "much of what is left is systematic: this model does not describe it"
    } else {
        "what is left is mostly noise of instrument and arm, which no model can learn"
    };
    html! {
        "Between each pose and its nearest neighbour the errors have a mean cosine of "
        @if evidence.nominal != evidence.calibrated {
            @if let Some(before) = agreement(&evidence.nominal().poses) { (format!("{before:.2}")) " before and " }
        }
        (crate::report::rounded(after, 2)) " after the calibration (1: they point the same way, 0: at random): " (verdict) "."
    }
}

/// Returns the next smaller number with one digit that is not 0.
fn one_digit(x: f64) -> f64 {
    let power = 10f64.powf(x.log10().floor());
    (x / power).floor().max(1.0) * power
}

/// Returns the smallest and the largest measured coordinates, in mm.
fn extent(poses: &[HeldOutPose]) -> ([f64; 3], [f64; 3]) {
    let fold = |start: f64, take: fn(f64, f64) -> f64| {
        [0, 1, 2].map(|i| poses.iter().map(|p| 1e3 * p.position[i]).fold(start, take))
    };
    (
        fold(f64::INFINITY, f64::min),
        fold(f64::NEG_INFINITY, f64::max),
    )
}
