//! The gauge on the command line: which base and tool a model is stated in, and by how much its commands move.

use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};
use nalgebra::Vector3;
use poegp_protocol::blob::FrameSource;
use poegp_runtime::math::se3::Pose;
use serde::{Deserialize, Serialize};

use crate::cli::failure::Failure;
use crate::cli::terminal::print::Printer;
use poegp_calibration::blob::predict::BlobModel;
use poegp_calibration::measurement::point_pairs::{PointPairs, Registration};
use poegp_calibration::measurement::sample::InstrumentSample;
use poegp_calibration::model::Calibration;
use poegp_calibration::model::gauge::{GaugeChoice, GaugeFrame, GaugeGrid};
use poegp_calibration::validation::command_change::CommandChange;

/// Options of the gauge.
#[derive(Args, Clone, Debug, Default)]
pub struct GaugeArgs {
    /// Target of the base-tool fit, if base and tool are neither kept nor stated. With the grid, the commands
    /// of two calibrations of one robot differ less.
    #[arg(long, value_enum, value_name = "FIT")]
    pub gauge: Option<GaugeFit>,
    /// Keep base and tool of an earlier blob of this robot, so that taught programs stay valid. Refused if the
    /// target or the instrument has moved since then (for a moved instrument, see --references).
    #[arg(long, value_name = "BLOB")]
    pub keep_gauge: Option<PathBuf>,
    /// Fixed points measured before and after the instrument was moved (CSV: before_x_mm …, after_x_mm …, at least three),
    /// for --keep-gauge.
    #[arg(long, value_name = "CSV", requires = "keep_gauge")]
    pub references: Option<PathBuf>,
    /// State the base: points known in its frame and measured (CSV: base_x_mm …, measured_x_mm …, at least three), or
    /// instrument_from_base as X,Y,Z,QW,QX,QY,QZ in mm.
    #[arg(
        long,
        value_name = "CSV|POSE",
        allow_hyphen_values = true,
        conflicts_with = "keep_gauge"
    )]
    pub base_from: Option<String>,
    /// State the tool: flange_from_target as X,Y,Z,QW,QX,QY,QZ in mm.
    #[arg(long, value_name = "POSE", allow_hyphen_values = true)]
    pub tool_from: Option<String>,
    /// Print how far the commands differ from those of an earlier blob (default: that of --keep-gauge).
    #[arg(long, value_name = "BLOB")]
    pub previous: Option<PathBuf>,
}

/// What base and tool are fitted to.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum, Deserialize, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum GaugeFit {
    /// The measured poses.
    Poses,
    /// The finished model over a fixed grid of poses (default).
    Grid,
}

/// The table `[gauge]` of a project file, with the same settings as [`GaugeArgs`].
#[derive(Clone, Debug, Default, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields, expecting = "a table [gauge] with its keys")]
pub struct GaugeTable {
    pub fit: Option<GaugeFit>,
    pub keep_gauge: Option<String>,
    pub references: Option<String>,
    pub base_from: Option<String>,
    pub tool_from: Option<String>,
    pub previous: Option<String>,
}

impl GaugeTable {
    pub fn is_empty(&self) -> bool {
        *self == Self::default()
    }
}

impl GaugeArgs {
    /// Completes the options of the command line with a project's table. Also returns the keys of the table that the command
    /// line overrides.
    pub fn completed(
        &self,
        table: &GaugeTable,
        resolve: impl Fn(&str) -> PathBuf,
    ) -> (Self, Vec<&'static str>) {
        let mut out = self.clone();
        let mut overridden = Vec::new();
        let mut path = |given: &mut Option<PathBuf>, stated: &Option<String>, key| match stated {
            Some(_) if given.is_some() => overridden.push(key),
            Some(name) => *given = Some(resolve(name)),
            None => {}
        };
        // A base that the command line states in another way replaces the project's.
        if out.base_from.is_none() {
            path(&mut out.keep_gauge, &table.keep_gauge, "gauge.keep_gauge");
            path(&mut out.references, &table.references, "gauge.references");
        }
        path(&mut out.previous, &table.previous, "gauge.previous");
        match table.fit {
            Some(_) if out.gauge.is_some() => overridden.push("gauge.fit"),
            stated => out.gauge = out.gauge.or(stated),
        }
        match &table.base_from {
            Some(_) if out.base_from.is_some() => overridden.push("gauge.base_from"),
            Some(_) if self.keep_gauge.is_some() => overridden.push("gauge.base_from"),
            Some(text) if is_pose(text) => out.base_from = Some(text.clone()),
            Some(name) => out.base_from = Some(resolve(name).display().to_string()),
            None => {}
        }
        match &table.tool_from {
            Some(_) if out.tool_from.is_some() => overridden.push("gauge.tool_from"),
            stated => out.tool_from = out.tool_from.or_else(|| stated.clone()),
        }
        (out, overridden)
    }

    /// Whether no option of the gauge was given.
    pub fn is_empty(&self) -> bool {
        self.table(|path| path.display().to_string()).is_empty()
    }

    /// Completes relative paths with `folder`.
    pub fn within(&mut self, folder: &Path) {
        let files = [
            &mut self.keep_gauge,
            &mut self.references,
            &mut self.previous,
        ];
        for path in files.into_iter().flatten() {
            *path = folder.join(&path);
        }
        if let Some(text) = self.base_from.as_mut().filter(|text| !is_pose(text)) {
            *text = folder.join(&text).display().to_string();
        }
    }

    /// Returns the files that these options read.
    pub fn inputs(&self) -> impl Iterator<Item = &Path> {
        let base = self.base_from.as_deref().filter(|text| !is_pose(text));
        let files = [&self.keep_gauge, &self.references, &self.previous];
        files
            .into_iter()
            .flatten()
            .map(PathBuf::as_path)
            .chain(base.map(Path::new))
    }

    /// Converts the options to a table of a project file, with paths as `relative` writes them.
    pub fn table(&self, relative: impl Fn(&Path) -> String) -> GaugeTable {
        let path = |path: &Option<PathBuf>| path.as_deref().map(&relative);
        let base = |text: &String| match is_pose(text) {
            true => text.clone(),
            false => relative(Path::new(text)),
        };
        GaugeTable {
            fit: self.gauge,
            keep_gauge: path(&self.keep_gauge),
            references: path(&self.references),
            base_from: self.base_from.as_ref().map(base),
            tool_from: self.tool_from.clone(),
            previous: path(&self.previous),
        }
    }
}

/// The part of the gauge that is known before the fit.
pub struct Known {
    pub choice: GaugeChoice,
    /// The blob whose frames are kept.
    kept: Option<(PathBuf, BlobModel)>,
    /// Another blob whose commands the new ones are compared with.
    compared: Option<(PathBuf, BlobModel)>,
    /// Registration of the points that state the base or that carry it over after the instrument was moved.
    registration: Option<Registration>,
}

impl Known {
    /// Reads the files that the options name.
    pub fn read(a: &GaugeArgs, robot: &str) -> Result<Self, Failure> {
        let mut out = Self {
            choice: GaugeChoice {
                over_grid: a.gauge != Some(GaugeFit::Poses),
                ..GaugeChoice::default()
            },
            kept: None,
            compared: None,
            registration: None,
        };
        if let Some(path) = &a.keep_gauge {
            let blob = of_robot(path, robot)?;
            out.keep(&blob);
            if let Some(file) = &a.references {
                let moved = PointPairs::read(file, "before", "after")?.registration(file)?;
                if let Some(base) = &mut out.choice.base {
                    base.pose = moved.pose * base.pose;
                }
                out.registration = Some(moved);
            }
            out.kept = Some((path.clone(), blob));
        }
        let stated = |pose| GaugeFrame {
            pose,
            source: FrameSource::Stated,
        };
        if let Some(text) = &a.base_from {
            let pose = if is_pose(text) {
                pose_of("--base-from", text)?
            } else {
                let file = Path::new(text);
                let found = PointPairs::read(file, "base", "measured")?.registration(file)?;
                out.registration = Some(found);
                found.pose
            };
            out.choice.base = Some(stated(pose));
        }
        if let Some(text) = &a.tool_from {
            out.choice.tool = Some(stated(pose_of("--tool-from", text)?));
        }
        if let Some(path) = &a.previous {
            out.compared = Some((path.clone(), of_robot(path, robot)?));
        }
        Ok(out)
    }

    /// Returns the blob whose commands the new ones are compared with.
    pub fn previous(&self) -> Option<&(PathBuf, BlobModel)> {
        self.compared.as_ref().or(self.kept.as_ref())
    }

    /// Returns the blob whose frames are kept as they were: none if fixed points state how its base has moved.
    pub fn unmoved(&self) -> Option<&(PathBuf, BlobModel)> {
        self.kept.as_ref().filter(|_| self.registration.is_none())
    }

    /// Returns whether the user states the tool.
    pub fn is_tool_stated(&self) -> bool {
        let tool = self.choice.tool.as_ref();
        tool.is_some_and(|tool| tool.source == FrameSource::Stated)
    }

    /// Keeps base, tool and grid of an earlier blob.
    fn keep(&mut self, blob: &BlobModel) {
        let gauge = &blob.host().gauge;
        let frame = |rows| GaugeFrame {
            pose: Pose::from_rows(rows),
            source: FrameSource::Previous,
        };
        let wide = |(lower, upper): &(f32, f32)| (f64::from(*lower), f64::from(*upper));
        self.choice = GaugeChoice {
            over_grid: false,
            grid: Some(GaugeGrid {
                ranges: gauge.ranges.iter().map(wide).collect(),
                payload_kg: gauge.payload_kg.map(f64::from),
            }),
            base: Some(frame(&gauge.instrument_from_base)),
            tool: Some(frame(&gauge.flange_from_target)),
        };
    }

    /// Summarises the gauge of a calibration with its samples.
    pub fn summary(
        &self,
        calibration: &Calibration,
        blob: &BlobModel,
        samples: &[InstrumentSample],
    ) -> Result<GaugeSummary, Failure> {
        let changed = self.previous().map(|(path, before)| {
            let wanted = samples.iter().map(|s| (s.joints.clone(), s.payload_kg));
            moved_against(path, before, blob, wanted)
        });
        let gauge = &calibration.gauge;
        Ok(GaugeSummary {
            base: source_name(gauge.base.source),
            tool: source_name(gauge.tool.source),
            grid_ranges: gauge.grid.ranges.clone(),
            grid_payload_kg: gauge.grid.payload_kg,
            points: self.registration.map(|r| PointsJson {
                points: r.points,
                rms_mm: 1e3 * r.rms,
            }),
            commands_move: changed.transpose()?,
        })
    }
}

/// The gauge in the `--json` document.
#[derive(Serialize)]
pub struct GaugeSummary {
    /// Source of the base: `poses`, `grid`, `previous` or `stated`; `tool` has the same values.
    pub base: &'static str,
    pub tool: &'static str,
    /// Joint ranges of the grid, rad or m.
    pub grid_ranges: Vec<(f64, f64)>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub grid_payload_kg: Option<f64>,
    /// The points that state the base or carry it over.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub points: Option<PointsJson>,
    /// Change of the commands against those of the earlier blob.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub commands_move: Option<CommandChange>,
}

#[derive(Serialize)]
pub struct PointsJson {
    pub points: usize,
    pub rms_mm: f64,
}

impl GaugeSummary {
    pub fn print(&self, report: Printer, previous: Option<&Path>) {
        report.line(format_args!(
            "  base and tool: {}",
            sources(self.base, self.tool, self.grid_payload_kg)
        ));
        if let Some(points) = &self.points {
            report.line(format_args!(
                "  base points: {} points, {:.3} mm RMS after the fit",
                points.points, points.rms_mm
            ));
        }
        if let (Some(change), Some(path)) = (&self.commands_move, previous) {
            report.line(commands_move(change, path));
        }
    }
}

/// Computes how far the commands of a model at `wanted`, joints and payloads, move against those of the blob `before`.
fn moved_against(
    path: &Path,
    before: &BlobModel,
    model: &BlobModel,
    wanted: impl Iterator<Item = (Vec<f64>, Option<f64>)>,
) -> Result<CommandChange, Failure> {
    CommandChange::new(before, model, wanted)
        .map_err(|error| Failure::Usage(format!("{}: {error}", path.display())))
}

/// Computes the same against an earlier blob of the model's robot, if there is one.
pub fn commands_moved(
    previous: Option<&Path>,
    model: &BlobModel,
    wanted: impl Iterator<Item = (Vec<f64>, Option<f64>)>,
) -> Result<Option<CommandChange>, Failure> {
    let Some(path) = previous else {
        return Ok(None);
    };
    let before = of_robot(path, model.blob().robot.name)?;
    moved_against(path, &before, model, wanted).map(Some)
}

/// Formats how far commands move against those of an earlier blob.
pub fn commands_move(change: &CommandChange, previous: &Path) -> String {
    format!(
        "  commands differ by {:.3} mm mean, {:.3} mm maximum from those of {} ({} poses)",
        change.position_mm.mean,
        change.position_mm.max,
        previous.display(),
        change.poses
    )
}

/// Describes the sources of base and tool in a sentence.
pub fn sources(base: &str, tool: &str, payload_kg: Option<f64>) -> String {
    let at = payload_kg.map_or(String::new(), |kg| format!(" at {kg} kg"));
    let text = |source: &str| match source {
        "poses" => "the nominal model fitted to the measured poses".to_owned(),
        "grid" => format!("the nominal model fitted to the model over a fixed grid of poses{at}"),
        "previous" => "those of the earlier model".to_owned(),
        "positions" => {
            "the nominal model fitted to positions alone, which do not show its orientation"
                .to_owned()
        }
        _ => "as stated".to_owned(),
    };
    match base == tool {
        true => text(base),
        false => format!("base: {}; tool: {}", text(base), text(tool)),
    }
}

/// Returns the name of a source in the JSON document.
pub fn source_name(source: FrameSource) -> &'static str {
    match source {
        FrameSource::Poses => "poses",
        FrameSource::Grid => "grid",
        FrameSource::Previous => "previous",
        FrameSource::Stated => "stated",
        FrameSource::Positions => "positions",
    }
}

/// Reads a blob and refuses it unless it is of `robot`, the robot that is calibrated.
pub fn of_robot(path: &Path, robot: &str) -> Result<BlobModel, Failure> {
    let blob = BlobModel::read(path)?;
    let found = blob.blob().robot.name;
    match found == robot {
        true => Ok(blob),
        false => Err(Failure::Usage(format!(
            "{}: found a model of \"{found}\", expected one of \"{robot}\"",
            path.display()
        ))),
    }
}

/// Whether a text is a pose rather than a file name.
fn is_pose(text: &str) -> bool {
    text.split(',').count() == 7
        && text
            .split(',')
            .all(|part| part.trim().parse::<f64>().is_ok())
}

/// Parses a pose given as X,Y,Z,QW,QX,QY,QZ in mm and a unit quaternion.
fn pose_of(option: &str, text: &str) -> Result<Pose<f64>, Failure> {
    let expected = "expected seven numbers X,Y,Z,QW,QX,QY,QZ: millimetres and a unit quaternion";
    let refused = |found: String| {
        Err(Failure::Usage(format!(
            "{option}: found {found}, {expected}"
        )))
    };
    let numbers: Option<Vec<f64>> = text
        .split(',')
        .map(|part| part.trim().parse().ok())
        .collect();
    let Some(&[x, y, z, w, i, j, k]) = numbers.as_deref() else {
        return refused(format!("\"{text}\""));
    };
    let norm = [w, i, j, k].iter().map(|x| x * x).sum::<f64>().sqrt();
    if !(norm - 1.0).abs().le(&1e-3) || ![x, y, z].iter().all(|x| x.is_finite()) {
        return refused(format!("a quaternion of length {norm:.4}"));
    }
    let [w, i, j, k] = [w, i, j, k].map(|x| x / norm);
    let translation = Vector3::new(x, y, z) * 1e-3;
    Ok(Pose::from_quaternion(
        w,
        &Vector3::new(i, j, k),
        translation,
    ))
}
