//! `trainer measure`: asks for one row of a plan after another, and prints after each what is known.

mod journal;
mod knowledge;
mod plan;
mod show;
mod source;
mod then;

use std::path::{Path, PathBuf};
use std::time::Instant;

use clap::Args;
use nalgebra::Vector3;

use crate::cli::args::{Gravity, RobotArgs, gravity, positive};
use crate::cli::failure::Failure;
use crate::cli::inputs::Arm;
use crate::cli::measure::journal::{Journal, OnDisk, SKIP, Word, first_line};
use crate::cli::measure::plan::Planned;
use crate::cli::measure::show::{End, Show, kept, undone};
use crate::cli::measure::source::{Lines, Origin};
use crate::cli::output::check_outputs;
use crate::cli::output::kind::Kind;
use crate::cli::terminal::print::{is_stdout, note, warning};
use poegp_calibration::identification::touch::added::Part;
use poegp_calibration::input_error::{InputError, counted};
use poegp_calibration::measurement::touch::TouchSet;
use poegp_calibration::model::touches::class_of;
use poegp_calibration::planning::next::doubt::copy_of;
use poegp_calibration::planning::next::outlook::Outlook;
use poegp_calibration::planning::next::waiting::{Waiting, waiting};
use poegp_calibration::planning::next::{Chooser, Next};
use poegp_calibration::robot::ClassPrior;

/// `trainer measure`.
#[derive(Debug, Args)]
#[command(
    after_help = "The program names the row of the plan to measure next: the one that most reduces the expected error \
    over the work volume. Enter what you measured as a line of CSV with the columns of OUT. The joints are those that \
    the controller shows; they need not be the planned ones. The line \"skip\" leaves out what cannot be measured, \
    \"undo\" takes back the last row, \
    \"undo 5\" row 5, \"end\" ends, and \"help\" shows the columns. A row is on disk before it is confirmed; start the same command again to \
    continue.\n\n\
    The expected error is a mean over the work volume, of a model without processes and with the noise that the rows show.\n\n\
    Examples:\n  \
    trainer measure --robot ur10 touches.csv --out measured.csv --until-mm 0.2\n  \
    trainer measure --robot abb-irb120 plan.csv --from tracker.log --out measured.csv\n  \
    trainer measure --robot ur10 wire.csv --from serial:/dev/ttyUSB0@9600 --out measured.csv --json -"
)]
pub struct Measure {
    #[command(flatten)]
    robot: RobotArgs,
    /// Plan of `plan` or `plan --touch`, with the rows to choose from.
    #[arg(value_name = "PLAN.csv")]
    plan: PathBuf,
    /// Description of the touched features (default: PLAN.toml beside PLAN.csv).
    #[arg(long, value_name = "FILE")]
    features: Option<PathBuf>,
    /// Measurement file or touch file to append the measured rows to.
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    /// Source of measured rows: `-` (standard input), serial:DEVICE[@BAUD], unix:PATH, tcp:HOST:PORT, or a
    /// file that another program appends to.
    #[arg(long, value_name = "SOURCE", default_value = "-")]
    from: Origin,
    /// End when the expected mean error is at most this, with a tracker after 25 poses or more; exit code 1 if
    /// it stays larger. For a verdict on 95 of 100 poses, use `calibrate --tolerance-mm`.
    #[arg(long, value_name = "MM", value_parser = positive)]
    until_mm: Option<f64>,
    /// Rows have x_mm, y_mm, z_mm and no orientation, as from one reflector.
    #[arg(long)]
    positions: bool,
    /// Gravity in the base frame in m/s², for robots on a wall or a ceiling (default: 0,0,-9.81).
    #[arg(long, value_name = "X,Y,Z", default_value = "0,0,-9.81", hide_default_value = true, allow_hyphen_values = true, value_parser = gravity)]
    gravity: Gravity,
    /// Write the dialogue as JSON, one document per line (`-`: standard output).
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
}

pub fn run(a: &Measure) -> Result<(), Failure> {
    if is_stdout(&a.out) {
        let expected = "a file that rows can be added to";
        return Err(InputError::new(&a.out, "standard output", expected).into());
    }
    let mut inputs = vec![a.plan.as_path(), Path::new(&a.robot.robot)];
    inputs.extend(a.features.as_deref());
    if let Origin::File(path) = &a.from {
        inputs.push(path);
    }
    let rows = (Some(a.out.as_path()), Kind::Rows);
    check_outputs(&[rows, (a.json.as_deref(), Kind::Dialogue)], &inputs)?;
    let arm = Arm::load(&a.robot.robot, &a.robot.chain)?;
    let planned = Planned::read(&a.plan, a.features.as_deref(), a.positions, &arm)?;
    let mut lines = Lines::open(&a.from)?;
    let (journal, torn) = Journal::open(&a.out)?;
    if let Some(torn) = torn {
        warning(format_args!(
            "{}: the last line was incomplete and is now a comment: {torn}",
            a.out.display()
        ));
    }
    let gravity = Vector3::from(a.gravity.0);
    let class = class_of(&arm.robot, &planned.set);
    let chooser = planned.chooser(&arm, gravity, class);
    lines.pass_over(&journal);
    let show = Show::new(a.json.as_deref(), planned.uncertain_below())?;
    let mut session = Session {
        options: a,
        arm: &arm,
        planned: &planned,
        header: journal.header(),
        journal,
        chooser,
        lines,
        gravity,
        class,
        found: None,
        missing: waiting(&planned.without_rows()),
        rows: 0,
        doubted: Vec::new(),
        outliers: Vec::new(),
        moved: None,
        incomplete: None,
        show,
    };
    session.resume()?;
    let end = session.work()?;
    session.finish(end)
}

struct Session<'a> {
    options: &'a Measure,
    arm: &'a Arm,
    planned: &'a Planned,
    journal: Journal,
    /// Columns of the measured rows, once they are known.
    header: Option<String>,
    chooser: Chooser<'a>,
    lines: Lines,
    gravity: Vector3<f64>,
    class: ClassPrior,
    found: Option<Outlook>,
    /// Features that still have too few rows.
    missing: Vec<Waiting>,
    rows: usize,
    /// Rows that contradict the others, with how far they are from their prediction in mm.
    doubted: Vec<(usize, Option<f64>)>,
    /// Rows that were reported as outliers.
    outliers: Vec<usize>,
    /// The row since which something moved, and what that may be, as it was reported.
    moved: Option<(usize, Vec<Part>)>,
    /// Why `calibrate` refuses the file although the expected error is small enough.
    incomplete: Option<InputError>,
    show: Show,
}

/// The response to the request for a row.
enum Answer {
    /// A row that is now on disk, together with all earlier rows.
    Row(Box<TouchSet>, OnDisk),
    /// The requested row cannot be measured.
    Skip,
    /// This row is to be taken back, as the text says.
    Undo(usize, String),
    /// No more rows will come.
    End,
}

impl Session<'_> {
    /// Continues from the rows that the file already contains.
    fn resume(&mut self) -> Result<(), Failure> {
        if self.look_again()? {
            let out = &self.options.out;
            self.show.resumed(out, self.rows, self.found.as_ref());
        }
        Ok(())
    }

    /// Computes from the file what is known and what is left of the plan; returns whether the file has rows.
    fn look_again(&mut self) -> Result<bool, Failure> {
        let Some(set) = self.so_far()? else {
            (self.rows, self.found) = (0, None);
            self.learn_all(None);
            self.missing = waiting(&self.planned.without_rows());
            return Ok(false);
        };
        self.rows = set.rows.len();
        self.doubt_all(&set);
        self.look(&set);
        for row in 0..set.rows.len() {
            if let Some(earlier) = copy_of(&set, row) {
                note(format_args!(
                    "row {} is a copy of row {} and does not count",
                    row + 1,
                    earlier + 1
                ));
            }
        }
        self.learn_all(Some(&set));
        self.report_outliers()?;
        self.report_moved(&set)?;
        Ok(true)
    }

    /// Parses the rows of the file; `None` if it has none.
    fn so_far(&self) -> Result<Option<TouchSet>, InputError> {
        let text = String::from_utf8_lossy(self.journal.bytes());
        let lines = text.lines().filter(|line| first_line(line).is_some());
        if lines.count() < 2 {
            return Ok(None);
        }
        let (out, bytes) = (&self.options.out, self.journal.bytes());
        self.planned.so_far(out, bytes, self.arm).map(Some)
    }

    /// Takes a row back.
    fn take_back(&mut self, row: usize, said: &str) -> Result<(), Failure> {
        let set = self.so_far()?;
        let line = set.and_then(|set| Some(set.rows.get(row.checked_sub(1)?)?.line));
        let Some(line) = line else {
            let found = format!("\"{said}\" after {}", counted(self.rows, "row"));
            let expected = undone(self.rows);
            let error = InputError::new(self.lines.name(), found, expected);
            // A source that repeats this answer must not take back a row that came behind it.
            let _ = self.journal.append(&format!("# {said}: refused"))?;
            return self.show.refused(&error);
        };
        let text = self.journal.take_back(line, said)?;
        self.show.taken_back(row, &text)?;
        self.outliers.clear();
        self.look_again()?;
        Ok(())
    }

    fn is_within(&self) -> bool {
        match (&self.found, self.options.until_mm) {
            (Some(found), Some(until)) => found.expected.mean_mm <= until,
            _ => false,
        }
    }

    /// Chooses the next row: first those that every feature needs. The first touches of a point only determine where the
    /// point is, so that each by itself never seems worth measuring.
    fn next(&mut self) -> Result<Result<Next, End>, Failure> {
        let missing = |feature| self.missing.iter().any(|(m, _)| Some(*m) == feature);
        if let Some(next) = self.chooser.best(missing) {
            return Ok(Ok(next));
        }
        let (out, bytes) = (&self.options.out, self.journal.bytes());
        let refusal = match self.is_within() {
            true => match self.planned.whole((out, bytes), &self.outliers, self.arm) {
                Ok(()) => return Ok(Err(End::Within)),
                Err(refusal) => Some(refusal),
            },
            false => None,
        };
        let text = |error: &InputError| error.to_string();
        if refusal.as_ref().map(text) != self.incomplete.as_ref().map(text) {
            if let Some(error) = &refusal {
                self.show.incomplete(self.options.until_mm, error)?;
            }
            self.incomplete = refusal;
        }
        Ok(self.chooser.best(|_| true).ok_or(End::UsedUp))
    }

    /// Returns the columns of a row.
    fn columns(&self) -> &str {
        self.header.as_deref().unwrap_or(&self.planned.header)
    }

    fn work(&mut self) -> Result<End, Failure> {
        let columns = self.columns().to_owned();
        self.show.columns(&columns)?;
        loop {
            let next = match self.next()? {
                Ok(next) => next,
                Err(end) => return Ok(end),
            };
            let asked = self
                .planned
                .asked(&self.planned.set.rows[next.row], self.arm);
            let left = self.chooser.left();
            let is_fitted = self.found.is_some();
            self.show.next(&asked, &next, self.arm, (left, is_fitted))?;
            match self.answer()? {
                Answer::End => return Ok(End::NoMore),
                Answer::Skip => {
                    let said = format!("# {SKIP}: {}", asked.name());
                    let _ = self.journal.append(&said)?;
                    self.chooser.skip(next.row);
                }
                Answer::Undo(row, said) => self.take_back(row, &said)?,
                Answer::Row(set, kept) => self.took(&set, &kept)?,
            }
        }
    }

    /// Waits for the next answer. Rows that cannot be used are reported, and the user is asked again.
    fn answer(&mut self) -> Result<Answer, Failure> {
        loop {
            let Some((number, line)) = self.lines.next()? else {
                if self.lines.is_torn() {
                    note("the last line has no end and was left out");
                }
                return Ok(Answer::End);
            };
            if first_line(&line).is_none() {
                continue;
            }
            match Word::of(&line) {
                Some(Word::End) => return Ok(Answer::End),
                Some(Word::Skip) => return Ok(Answer::Skip),
                Some(Word::Undo(row, said)) => {
                    return Ok(Answer::Undo(row.unwrap_or(self.rows), said));
                }
                Some(Word::Help) => {
                    let columns = self.columns().to_owned();
                    self.show.columns(&columns)?;
                }
                Some(Word::Unknown) => {
                    let found = format!("the word \"{}\"", line.trim());
                    let error = InputError::new(self.lines.name(), found, Word::EXPECTED);
                    self.show.refused(&error.at_line(number))?;
                }
                None => match self.taken(number, &line) {
                    Ok(Some((set, kept))) => return Ok(Answer::Row(Box::new(set), kept)),
                    Ok(None) => {}
                    Err(Failure::Input(error)) => self.show.refused(&error)?,
                    Err(failure) => return Err(failure),
                },
            }
        }
    }

    /// Parses a line and, if it is a row, puts it on disk; returns `None` for a header.
    fn taken(&mut self, number: usize, line: &str) -> Result<Option<(TouchSet, OnDisk)>, Failure> {
        let fields = |line: &str| line.split(',').count();
        let are_other_columns = fields(self.columns()) != fields(line);
        let of_input = |mut error: InputError| {
            error.line = error.line.map(|_| number);
            match are_other_columns && self.journal.header().is_none() {
                true => error.with_help(
                    "if your rows have other columns, enter a line with their names first, such as \
                     payload_kg,q1_deg,…",
                ),
                false => error,
            }
        };
        if line.contains(char::REPLACEMENT_CHARACTER) {
            let found = "bytes that are not UTF-8 text";
            let error = InputError::new(self.lines.name(), found, "a row as CSV");
            return Err(error.at_line(number).into());
        }
        if line.split(',').any(|field| field.trim().starts_with("q1_")) {
            // Other columns may still come until the first row is on disk.
            let known = self.journal.header();
            let header = known.unwrap_or_else(|| line.to_owned());
            let same = header
                .split(',')
                .map(str::trim)
                .eq(line.split(',').map(str::trim));
            return match same {
                true => {
                    self.header = Some(header);
                    Ok(None)
                }
                false => Err(InputError::new(
                    self.lines.name(),
                    "other columns than before",
                    format!("the columns {header}"),
                )
                .at_line(number)
                .into()),
            };
        }
        let header = self.columns();
        let alone = format!("{header}\n{line}\n");
        let name = self.lines.name();
        self.planned
            .so_far(name, alone.as_bytes(), self.arm)
            .map_err(of_input)?;
        // The row is read once more with all earlier rows, because its tools and the like depend on them.
        let lines = match self.journal.header() {
            Some(_) => line.to_owned(),
            None => format!("{header}\n{line}"),
        };
        let mut all = self.journal.bytes().to_vec();
        all.extend(format!("{lines}\n").bytes());
        let set = self
            .planned
            .so_far(name, &all, self.arm)
            .map_err(of_input)?;
        if let Some(earlier) = copy_of(&set, set.rows.len() - 1) {
            let found = format!("a copy of row {}, equal in every digit", earlier + 1);
            let error = InputError::new(name, found, "a row that was measured by itself");
            return Err(error.at_line(number).into());
        }
        self.header = Some(header.to_owned());
        let kept = self.journal.append(&lines)?;
        Ok(Some((set, kept)))
    }

    /// Confirms a row, and prints what is now known.
    fn took(&mut self, set: &TouchSet, kept: &OnDisk) -> Result<(), Failure> {
        let index = set.rows.len() - 1;
        self.rows = set.rows.len();
        self.show.taken(self.rows, kept)?;
        let before = self.found.as_ref().map(|found| found.expected.mean_mm);
        let begun = Instant::now();
        self.doubt(set, index..self.rows);
        self.look(set);
        let outliers: Vec<usize> = self.contradicting().iter().map(|(row, _)| *row).collect();
        let earlier = outliers.iter().filter(|row| **row != index);
        match earlier.eq(&self.outliers) {
            true => self.learn(set, index),
            false => self.learn_all(Some(set)),
        }
        let seconds = begun.elapsed().as_secs_f64();
        let until = self.options.until_mm;
        let outliers: Vec<usize> = outliers.iter().map(|row| row + 1).collect();
        let found = self.found.as_ref();
        self.show
            .known(self.rows, found, &outliers, before, until, seconds)?;
        self.report_outliers()?;
        self.report_moved(set)
    }

    fn finish(mut self, end: End) -> Result<(), Failure> {
        self.journal.check()?;
        let options = self.options;
        let (robot, gravity) = (&options.robot, options.gravity);
        let features = self.planned.features();
        let calibrate = then::calibrate(robot, gravity, &options.out, features);
        let bytes = self.journal.bytes();
        let refusal = self
            .planned
            .refusal(&options.out, bytes, self.arm, self.gravity)?;
        let is_within = self.is_within();
        let incomplete = match is_within {
            true => self
                .planned
                .whole((&options.out, bytes), &self.outliers, self.arm)
                .err(),
            false => None,
        };
        let foreseen = self.foreseen();
        let refusal = refusal.or(foreseen.refused);
        let then = refusal.is_none().then_some(calibrate.as_str());
        let found = self.found.as_ref();
        self.show
            .end(end, self.rows, found, options.until_mm, then)?;
        self.show.used(&foreseen.used, refusal.is_some());
        if let Some(text) = refusal {
            return Err(Failure::Quality(format!(
                "{}: {text}\nhelp: {} kept, but `calibrate` refuses {}",
                options.out.display(),
                kept(self.rows),
                if self.rows == 1 { "it" } else { "them" }
            )));
        }
        let is_reached = is_within && incomplete.is_none();
        match (end, options.until_mm) {
            (End::UsedUp | End::NoMore, Some(until)) if !is_reached => {
                let (found, expected) = match (&incomplete, found) {
                    (Some(error), _) => (
                        format!("{until} mm, but {}", error.found),
                        format!("{}, which `calibrate` needs", error.expected),
                    ),
                    (None, Some(found)) => (
                        format!("an expected error of {:.3} mm", found.expected.mean_mm),
                        format!("{until} mm or less"),
                    ),
                    (None, None) => (
                        "no expected error: too few rows".to_owned(),
                        format!("{until} mm or less"),
                    ),
                };
                let out = options.out.display();
                Err(Failure::Quality(format!(
                    "{out}: found {found}, expected {expected}\n\
                     help: {} kept; plan more rows and continue with the same --out",
                    kept(self.rows)
                )))
            }
            _ => Ok(()),
        }
    }
}
