//! `trainer correct --report`: which targets of a robot program move, by how much, and which parts stay as they are.
//!
//! The numbers that summarise the program are those of the JSON document.

use std::collections::HashMap;

use maud::{Markup, html};

use crate::cli::correct::document::{FrameJson, ProgramJson};
use crate::report::chart::{Axis, Brush, Plot, Series};
use crate::report::{Column, Number, Page, Provenance, Section, rounded, sections};
use crate::robot_programs::correction::between::Between;
use crate::robot_programs::correction::engine::Outcome;
use crate::robot_programs::correction::program::{Goal, Program, Target};
use crate::robot_programs::correction::replacement::Solved;
use crate::robot_programs::correction::source::Number as Written;

/// Largest number of targets, and of uncorrected parts, that the page lists, so that it stays small.
const SHOWN: usize = 1000;

/// A corrected target as the page lists it.
struct Row {
    file: String,
    line: usize,
    before: String,
    after: String,
    moved_mm: f64,
    moved_deg: f64,
    before_mm: f64,
    after_um: f64,
    /// Largest error on the way to the target; `None` unless the move is a line or an arc.
    between_mm: Option<f64>,
}

/// Renders the report of a corrected program.
pub fn page(
    d: &ProgramJson,
    program: &Program,
    outcome: &Outcome,
    between: &[Between],
    origin: &Provenance,
) -> String {
    let rows = rows(program, outcome, between);
    Page::new(
        format!("Corrected program {}", d.files.join(", ")),
        format!(
            "{}, for {}, {} by the model `{}`, poegp trainer {}",
            d.language, origin.robot, origin.date, d.method, d.version
        ),
    )
    .with(headline(d))
    .with(targets(&rows))
    .with(left(d))
    .with(frames(d))
    .with(sections::provenance(origin))
    .render()
}

fn rows(program: &Program, outcome: &Outcome, between: &[Between]) -> Vec<Row> {
    let replacements = outcome.replacements.iter();
    let new: HashMap<(usize, usize), String> = replacements
        .filter(|r| r.span.0 < r.span.1)
        .map(|r| {
            let text = String::from_utf8_lossy(&r.text).into_owned();
            ((r.file, r.span.0), text)
        })
        .collect();
    let mut largest: HashMap<usize, f64> = HashMap::new();
    for b in between {
        let slot = largest.entry(b.target).or_default();
        *slot = slot.max(b.largest);
    }
    let row = |solved: &Solved| {
        let target = &program.targets[solved.target];
        let source = &program.sources[target.location.file];
        let old = |n: &Written| {
            let source = &program.sources[n.file as usize];
            String::from_utf8_lossy(source.slice(&n.span())).into_owned()
        };
        let replaced = |n: &Written| {
            let found = new.get(&(n.file as usize, n.start as usize));
            found.map_or_else(|| old(n), Clone::clone)
        };
        Row {
            file: source.path.display().to_string(),
            line: source.line_and_column(target.location.at).0,
            before: listed(target, old),
            after: listed(target, replaced),
            moved_mm: 1e3 * solved.moved.0,
            moved_deg: solved.moved.1.to_degrees(),
            before_mm: 1e3 * solved.before,
            after_um: 1e6 * solved.after,
            between_mm: largest.get(&solved.target).map(|m| 1e3 * m),
        }
    };
    outcome.solved.iter().map(row).collect()
}

/// Formats the numbers of a target as the file writes them.
fn listed(target: &Target, text: impl Fn(&Written) -> String) -> String {
    let all = |numbers: &[Written]| numbers.iter().map(&text).collect::<Vec<_>>().join(", ");
    match &target.goal {
        Goal::Joints(numbers) => all(numbers),
        Goal::Pose {
            position,
            orientation,
        } => format!("{}; {}", all(position), all(orientation)),
    }
}

fn headline(d: &ProgramJson) -> Section {
    let lead = html! {
        p class="lead" {
            (Number::count(d.targets, "/targets"))
            @if d.targets == 1 { " target is corrected, " } @else { " targets are corrected, " }
            (Number::count(d.joint_targets, "/joint_targets")) " of joints and "
            (Number::count(d.pose_targets, "/pose_targets")) " of poses; "
            @if d.left.is_empty() { "nothing is left." }
            @else if d.left.len() == 1 { b class="nominal" { "1" } " part of the program is not corrected, or only partially." }
            @else { b class="nominal" { (d.left.len()) } " parts of the program are not corrected, or only partially." }
        }
    };
    let tile = |name: &str, number: Number, unit: &str, below: Markup| {
        html! {
            div class="tile" { h3 { (name) } div class="value" { (number) " " span { (unit) } } p { (below) } }
        }
    };
    let mut section = Section::new("result", "").block(lead);
    if let (Some(moved), Some(deg), Some(before), Some(after)) =
        (&d.moved_mm, &d.moved_deg, &d.before_mm, &d.after_um)
    {
        section = section.block(html! {
            div class="tiles" {
                (tile("Uncorrected, the tool is off by", Number::mm(before.mean, "/before_mm/mean"), "mm", html! {
                    "on average, " (Number::mm(before.max, "/before_mm/max")) " mm at most"
                }))
                (tile("At the corrected targets, at most", Number::new(after.max, 2, "/after_um/max"), "µm", html! {
                    (Number::new(after.mean, 2, "/after_um/mean")) " µm on average; and " (Number::new(d.rounding_um, 2, "/rounding_um")) " µm for the decimals of the file"
                }))
                (tile("The written targets move by", Number::mm(moved.mean, "/moved_mm/mean"), "mm", html! {
                    "and " (Number::new(deg.mean, 4, "/moved_deg/mean")) "° on average, "
                    (Number::mm(moved.max, "/moved_mm/max")) " mm and " (Number::new(deg.max, 4, "/moved_deg/max")) "° at most"
                }))
                @if let Some(b) = &d.between {
                    (tile("Between the ends of lines and arcs", Number::mm(b.largest_mm, "/between/largest_mm"), "mm", html! {
                        "at most, of " (Number::count(b.moves, "/between/moves")) " moves, on the way to " (b.file) ":"
                        (Number::count(b.line, "/between/line"))
                    }))
                }
            }
        });
    }
    section = section.text(html! {
        "All errors are computed from the model, not measured. Check some of the corrected targets on the robot."
    });
    if let Some(split) = &d.split {
        section = section.text(html! {
            (Number::count(split.targets, "/split/targets")) " targets are inserted on "
            (Number::count(split.lines, "/split/lines")) " lines, so that the tool stays within "
            (Number::mm(split.tolerance_mm, "/split/tolerance_mm")) " mm of each."
        });
    }
    for remark in &d.remarks {
        section = section.text(html! { "Note: " (remark) "." });
    }
    section
}

fn targets(rows: &[Row]) -> Section {
    let section = Section::new("targets", "The targets");
    if rows.is_empty() {
        return section.missing("No target was corrected.");
    }
    let errors: Vec<f64> = rows
        .iter()
        .flat_map(|row| [row.before_mm, row.between_mm.unwrap_or(row.before_mm)])
        .collect();
    let mut plot = Plot::new(
        Axis::linear("target, in the order of the moves", 0.0, rows.len() as f64),
        Axis::errors("distance (mm)", &errors),
    );
    let at = |i: usize| i as f64 + 0.5;
    let mut shown: Vec<usize> = (0..rows.len()).collect();
    if shown.len() > SHOWN {
        shown.sort_by(|a, b| rows[*b].before_mm.total_cmp(&rows[*a].before_mm));
        shown.truncate(SHOWN);
        shown.sort_unstable();
    }
    let before = |(row, i): (usize, &usize)| (row, (at(*i), rows[*i].before_mm));
    let between = |(row, i): (usize, &usize)| rows[*i].between_mm.map(|mm| (row, (at(*i), mm)));
    let targets = || shown.iter().enumerate();
    plot.poses(Series::Nominal, Brush::Range, targets().map(before));
    plot.poses(
        Series::Calibrated,
        Brush::Range,
        targets().filter_map(between),
    );
    let table = shown.iter().map(|i| {
        let row = &rows[*i];
        vec![
            html! {
                div { (row.file) ":" (row.line) }
                p class="note" { (row.before) }
                @if row.after != row.before { p class="note" { b { (row.after) } } }
            },
            html! { (rounded(row.moved_mm, 3)) },
            html! { (rounded(row.moved_deg, 4)) },
            html! { (rounded(row.before_mm, 3)) },
            html! { (rounded(row.after_um, 2)) },
            html! { @if let Some(mm) = row.between_mm { (rounded(mm, 3)) } },
        ]
    });
    let table: Vec<Vec<Markup>> = table.collect();
    let section = section
        .figure(
            html! { "What the correction removes, and what remains between the targets" },
            plot.render("distance of the tool from each target without correction, and on the way there with it"),
            "Each target has a dot: the distance of the tool from it without correction. Where a line or an arc leads to it, the \
             dot of the other colour is the largest distance on the way there, between corrected ends.",
        )
        .text(html! {
            "Numbers as the file has them, before and after."
            @if rows.len() > SHOWN {
                " Of the " (rows.len()) " targets the plot and the table have the " (SHOWN) " with the largest distance."
            }
        })
        .answers();
    let mut columns = vec![Column::Name("target, before and after".into())];
    columns.extend(["moves (mm)", "turns (°)"].map(|name| Column::Other(name.into())));
    columns.push(Column::Error("off without (mm)".into()));
    columns.extend(["off with (µm)", "on the way (mm)"].map(|name| Column::Other(name.into())));
    section.poses(&columns, table, None)
}

fn left(d: &ProgramJson) -> Section {
    let section = Section::new("left", "What is left");
    if d.left.is_empty() {
        return section.missing("Nothing: every target of the program is corrected.");
    }
    section
        .text(html! {
            "These parts are not corrected, or only partially. Where no remaining error is stated, the error is the \
            same as before."
            @if d.left.len() > SHOWN { " The first " (SHOWN) " of " (d.left.len()) " are shown." }
        })
        .block(html! {
            dl {
                @for l in d.left.iter().take(SHOWN) {
                    dt { (l.file) ":" (l.line) ":" (l.column) } dd { (l.reason) }
                }
            }
        })
}

fn frames(d: &ProgramJson) -> Section {
    let section = Section::new("frames", "Tools and frames");
    if d.frames.is_empty() {
        return section.missing("No target needs one.");
    }
    let row = |(i, f): (usize, &FrameJson)| {
        vec![
            html! { (f.name) },
            html! { (f.kind) },
            html! { (f.from) },
            html! {
                @if let Some(kg) = f.payload_kg { (Number::new(kg, 3, format!("/frames/{i}/payload_kg"))) }
            },
        ]
    };
    section.table(
        &["name", "kind", "from", "payload, kg"],
        d.frames.iter().enumerate().map(row).collect(),
    )
}
