//! Tests whether accepted calibrations help, and whether what they state is true. The arms are of several types, from an
//! independent simulator, and within or outside of the class that is stated for them.
//!
//! `cargo test --release -p poegp-calibration --test touch -- trust::many --ignored --nocapture` prints the tables of
//! docs/evidence/touches.md.

use std::collections::BTreeMap;

use poegp_calibration::numeric::statistics::Summary;
use poegp_calibration::robot::{LoadOptions, Robot};
use poegp_calibration::simulation::Scenario;
use poegp_calibration::validation::conformity::{Conformity, Tolerances};

use crate::sets::{mean_mm, share_within};
use crate::trial::{Trial, simulated, trial};

/// Arm type, the errors it is simulated with, the factor of the stated class over the true one, and the first seed.
type Variant = (&'static str, Scenario, f64, u64);

const VARIANTS: [Variant; 7] = [
    ("abb-irb120", Scenario::Paper, 1.0, 9000),
    ("abb-irb120", Scenario::Paper, 2.0, 9100),
    ("ur10", Scenario::Paper, 1.0, 9200),
    ("kuka-iiwa7", Scenario::WithBacklash, 1.0, 9300),
    ("abb-irb120", Scenario::Paper, 0.5, 9400),
    ("abb-irb120", Scenario::Nonlinear, 0.5, 9500),
    ("ur10", Scenario::Nonlinear, 1.0, 9600),
];

/// What is touched.
const ROWS: [&[(&str, usize)]; 12] = [
    &[("socket", 1)],
    &[("socket", 2)],
    &[("socket", 4)],
    &[("wire", 1)],
    &[("wire", 3)],
    &[("socket", 2), ("wire", 1)],
    &[("camera", 1)],
    &[("ballbar", 4)],
    &[("plane", 3)],
    &[("sphere", 4)],
    &[("plane", 1)],
    &[("level", 1)],
];

/// Largest share of the accepted calibrations that may be worse than the nominal model, and the largest ratio of an accepted
/// calibration's error to the nominal model's.
const WORSE: f64 = 0.05;
const WORST: f64 = 1.2;
/// Least share of the errors within the stated 95 %, and least shares of cells that must reach it: of all cells, and of the
/// cells of arms within their class.
const COVERED: f64 = 0.85;
const CELLS: f64 = 0.85;
const CELLS_WITHIN_CLASS: f64 = 0.9;

/// Largest share of "conforms" verdicts at a tolerance that the arm just misses.
const WRONG: f64 = 0.05;

/// Accepted ratio of the stated mean error to the true one.
const STATED: std::ops::Range<f64> = 0.8..1.5;

/// Counts over accepted and refused calibrations.
#[derive(Default)]
struct Count {
    accepted: usize,
    worse: usize,
    worst: f64,
    /// Sums of the stated and of the true mean errors, mm.
    stated: f64,
    found: f64,
    refused: usize,
    /// Verdicts where E ± U covers the error that 95 of 100 poses do not exceed, and verdicts where E + U is below it.
    judged: [usize; 2],
    /// Refused calibrations with an error below 0.8 of the nominal model's, below 0.5 of it, and above it.
    lost: [usize; 3],
}

impl Count {
    fn row(&self, head: &str) -> String {
        let [small, smaller, worse] = self.lost;
        format!(
            "| {head} | {} | {} | {:.2} | {} | {small} | {smaller} | {worse} |",
            self.accepted, self.worse, self.worst, self.refused
        )
    }
}

/// Coverage in each trial of a cell: share of errors within the stated 95 %, and of components within 1.96 standard deviations.
#[derive(Default)]
struct Covered {
    all: Vec<[f64; 2]>,
}

impl Covered {
    fn mean(&self, i: usize) -> f64 {
        self.all.iter().map(|c| c[i]).sum::<f64>() / self.all.len() as f64
    }
}

/// Returns the upper 95 % confidence limit of a share, when `found` of `of` cases were seen (Clopper and Pearson 1934).
fn upper_limit(found: usize, of: usize) -> f64 {
    let (mut low, mut high) = (0.0, 1.0);
    for _ in 0..60 {
        let p: f64 = 0.5 * (low + high);
        let mut term = of as f64 * libm::log1p(-p);
        let mut sum = libm::exp(term);
        for k in 1..=found {
            term += libm::log((of - k + 1) as f64 / k as f64 * p / (1.0 - p));
            sum += libm::exp(term);
        }
        if sum > 0.05 { low = p } else { high = p }
    }
    high
}

fn score(of: &Trial, count: &mut Count, covered: &mut Covered) {
    let ratio = mean_mm(&of.calibrated) / mean_mm(&of.drawn);
    if of.found.findings.is_refused() {
        count.refused += 1;
        let lost = [ratio < 0.8, ratio < 0.5, ratio > 1.0];
        (0..3).for_each(|i| count.lost[i] += usize::from(lost[i]));
        return;
    }
    count.accepted += 1;
    count.worse += usize::from(ratio > 1.0);
    count.worst = count.worst.max(ratio);
    count.stated += of.known.after.mean_mm;
    count.found += mean_mm(&of.calibrated);
    let truth = Summary::of(of.calibrated.iter().map(|e| 1e3 * e.norm()).collect()).p95;
    let verdict =
        Conformity::of_touches(&of.known.exceeded, &Tolerances::default(), |_| None).position;
    count.judged[0] += usize::from((truth - verdict.error).abs() <= verdict.expanded);
    count.judged[1] += usize::from(verdict.met < truth);
    covered.all.push([
        share_within(&of.calibrated, of.known.after.p95_mm),
        of.components_within(),
    ]);
}

fn law(variants: &[Variant], counts: &[usize], arms: u64) {
    let mut cells: BTreeMap<(usize, usize, usize), Covered> = BTreeMap::new();
    let mut all = Count::default();
    let heads: Vec<String> = counts.iter().map(ToString::to_string).collect();
    let head = format!(
        "\n| touched | {} |\n|---|{}",
        heads.join(" | "),
        "---|".repeat(counts.len())
    );
    let mut rows = vec![
        "| arms | stated class over true | accepted | worse | worst | refused | of them below 0.8 | below 0.5 | worse |".to_owned(),
        "|---|---|---|---|---|---|---|---|---|".to_owned(),
    ];
    for (v, (name, scenario, class, seed)) in variants.iter().enumerate() {
        let robot = Robot::load(name, &LoadOptions::default()).unwrap();
        let mut count = Count::default();
        for (r, row) in ROWS.iter().enumerate() {
            for (c, touches) in counts.iter().enumerate() {
                for arm in 1..=arms {
                    let found = simulated(&robot, *scenario, row, *touches, seed + arm);
                    let Some((mut set, truth)) = found else {
                        continue;
                    };
                    let prior = set.prior.as_mut().unwrap();
                    prior.length *= class;
                    prior.tilt *= class;
                    prior.joint_zero *= class;
                    let of = trial(&robot, &set, &truth);
                    let before = count.worst;
                    score(&of, &mut count, cells.entry((v, r, c)).or_default());
                    if count.worst > before.max(1.0) {
                        eprintln!(
                            "{name} {scenario:?}, class {class}, {row:?}, {touches} touches, seed {}: {:.2} times the nominal model's error, \
                             left out {:.2}, probability {:.3}",
                            seed + arm,
                            count.worst,
                            of.found.summary.left_out_ratio,
                            of.found.summary.worse_probability
                        );
                    }
                }
            }
        }
        rows.push(count.row(&format!("{name}, {scenario:?} | {class}")));
        println!("{}\n{head}", rows[rows.len() - 1]);
        for (r, row) in ROWS.iter().enumerate() {
            let text = |c: usize| match cells.get(&(v, r, c)) {
                Some(covered) if !covered.all.is_empty() => {
                    let percent = [0, 1].map(|i| format!("{:.0}", 100.0 * covered.mean(i)));
                    percent.join(" / ")
                }
                _ => "–".to_owned(),
            };
            let texts: Vec<String> = (0..counts.len()).map(text).collect();
            let names: Vec<String> = row.iter().map(|(n, k)| format!("{n} × {k}")).collect();
            println!("| {} | {} |", names.join(", "), texts.join(" | "));
        }
        all.accepted += count.accepted;
        all.worse += count.worse;
        all.worst = all.worst.max(count.worst);
        all.refused += count.refused;
        all.stated += count.stated;
        all.found += count.found;
        (0..3).for_each(|i| all.lost[i] += count.lost[i]);
        let [covered, wrong] = count
            .judged
            .map(|n| 100.0 * n as f64 / count.accepted as f64);
        println!("\nverdicts: {covered:.1} % covered, {wrong:.1} % wrongly conform");
        (0..2).for_each(|i| all.judged[i] += count.judged[i]);
    }
    rows.push(all.row("all | "));
    println!("\n{}", rows.join("\n"));
    println!(
        "{:.2} % of the accepted are worse than the nominal model, with 95 % confidence at most {:.2} %\n",
        100.0 * all.worse as f64 / all.accepted as f64,
        100.0 * upper_limit(all.worse, all.accepted)
    );
    cells.retain(|_, covered| !covered.all.is_empty());
    let within = |v: usize| variants[v].2 >= 1.0;
    for (i, what) in ["errors", "components"].iter().enumerate() {
        let share = |only: bool| {
            let cells = cells.iter().filter(|((v, _, _), _)| !only || within(*v));
            let all: Vec<f64> = cells.map(|(_, covered)| covered.mean(i)).collect();
            all.iter().filter(|c| **c >= COVERED).count() as f64 / all.len().max(1) as f64
        };
        println!(
            "{what}: 85 % or more are covered in {:.1} % of the cells, of arms within their class in {:.1} %",
            100.0 * share(false),
            100.0 * share(true)
        );
        assert!(share(false) >= CELLS, "{what}: {:.3}", share(false));
        assert!(
            share(true) >= CELLS_WITHIN_CLASS,
            "{what}: {:.3}",
            share(true)
        );
    }
    let [covered, wrong] = all.judged.map(|n| n as f64 / all.accepted as f64);
    println!(
        "verdicts: E ± U covers {:.1} %, {:.1} % wrongly conform",
        100.0 * covered,
        100.0 * wrong
    );
    assert!(wrong <= WRONG, "{wrong:.3}");
    let stated = all.stated / all.found;
    println!("the stated mean error is {stated:.2} times the true one");
    assert!(STATED.contains(&stated), "{stated:.2}");
    let worse = all.worse as f64 / all.accepted as f64;
    assert!(
        worse <= WORSE && all.worst <= WORST,
        "{worse:.3}, {:.2}",
        all.worst
    );
    assert!(all.refused > 0, "nothing is refused");
}

/// A few arms of each kind.
#[test]
fn what_is_accepted_helps_and_what_is_stated_is_true() {
    law(&[VARIANTS[0], VARIANTS[5]], &[8, 20, 80], 2);
}

/// Many arms.
#[test]
#[ignore = "a quarter of an hour in release; its command is in the head of this file"]
fn many() {
    law(&VARIANTS, &[8, 12, 20, 40, 80], 10);
}
