//! Command-line arguments that several commands share.

use clap::Args;
use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use serde::de::{DeserializeOwned, IntoDeserializer, value};

use crate::cli::terminal::print::note;
use poegp_calibration::blob::fitted_frames::FramesToFit;
use poegp_calibration::learning::elastic::options::{OutlierPolicy, WarmUpPolicy};
use poegp_calibration::learning::task_space::fit::HyperparameterSharing;
use poegp_calibration::measurement::noise::InstrumentNoise;
use poegp_calibration::model::Method;
use poegp_calibration::model::config::{Config, MAX_INDUCING_POINTS, Weighting};

/// Headings of the option groups in the long help.
pub mod heading {
    pub const MEASUREMENTS: &str = "Measurements";
    pub const MODEL: &str = "Model";
    pub const FRAMES: &str = "Base and tool";
    pub const DEVICE: &str = "Limits for the device";
    pub const TOLERANCE: &str = "Tolerance";
    pub const RECORDS: &str = "Records";
    pub const PROGRAMS: &str = "Robot programs";
    pub const CHOICE: &str = "Choice of poses";
    pub const TOUCHES: &str = "Touches";
    pub const FORECAST: &str = "Forecast";
    /// Heading of the options that every command has; it stands last.
    pub const GENERAL: &str = "General options";
}

/// A robot description.
#[derive(Debug, Args)]
pub struct RobotArgs {
    /// URDF file, TOML description, or built-in robot: abb-irb4400, abb-irb4400-serial, abb-irb120, kuka-iiwa7, ur5, ur10.
    #[arg(long)]
    pub robot: String,
    #[command(flatten)]
    pub chain: ChainArgs,
}

/// Ends of the kinematic chain in a URDF.
#[derive(Clone, Debug, Args)]
pub struct ChainArgs {
    /// URDF link at which the chain begins (default: the root).
    #[arg(long, value_name = "LINK")]
    pub base: Option<String>,
    /// URDF link at which the chain ends, the flange (default: the only leaf, or tool0, flange, ee_link).
    #[arg(long, value_name = "LINK")]
    pub tip: Option<String>,
}

/// Settings of the calibration; what is not given keeps the value of the project file or the default.
#[derive(Debug, Args)]
pub struct FitArgs {
    #[command(flatten, next_help_heading = heading::MEASUREMENTS)]
    pub noise: NoiseArgs,
    /// Treatment of outliers; they are listed either way (default: reject).
    #[arg(long, value_name = "POLICY", value_parser = outliers(), help_heading = heading::MEASUREMENTS)]
    pub outliers: Option<OutlierPolicy>,
    /// Treatment of a warm-up, a change of base, tool and joint zeros with time that the elastic method finds
    /// and reports (default: remove).
    #[arg(long, value_name = "POLICY", value_parser = warm_up(), help_heading = heading::MEASUREMENTS)]
    pub warm_up: Option<WarmUpPolicy>,
    /// Weights of the measurements in step 1 of the paper (default: none).
    #[arg(long, value_name = "WEIGHTS", value_parser = weighting(), help_heading = heading::MODEL)]
    pub weighting: Option<Weighting>,
    /// Separate hyperparameters for each of the six outputs of the paper's process: more accurate, but slower
    /// on the device.
    #[arg(long, help_heading = heading::MODEL)]
    pub per_output: bool,
    /// Leave the predictive standard deviation of the position out of the blob.
    #[arg(long, help_heading = heading::MODEL)]
    pub no_variance: bool,
    /// Gravity in the base frame in m/s², for robots on a wall or a ceiling (default: 0,0,-9.81).
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true, value_parser = gravity, help_heading = heading::MODEL)]
    pub gravity: Option<Gravity>,
    /// Largest number of inducing points of the elastic model, of all joints together (default: 200). More
    /// are more accurate and slower.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=MAX_INDUCING_POINTS as i64),
        help_heading = heading::DEVICE)]
    pub inducing_points: Option<u32>,
}

/// What is fitted to new measurements, or taken out of them, before they are compared with predictions.
#[derive(Clone, Copy, Debug, Default, Args)]
pub struct FrameArgs {
    /// First fit the base frame to these measurements, after the instrument was moved.
    #[arg(long)]
    pub fit_base: bool,
    /// First fit the frames of remounted or new targets to these measurements. With ROWS, fit to that many
    /// rows of each tool, evenly spread, and compare the others.
    #[arg(long, value_name = "ROWS", num_args = 0..=1, value_parser = clap::value_parser!(u32).range(1..))]
    pub fit_tool: Option<Option<u32>>,
    /// Remove the instrument's drift from every pose, estimated from reference points (columns ref1_x_mm …).
    #[arg(long, help_heading = heading::MEASUREMENTS)]
    pub correct_drift: bool,
}

impl FrameArgs {
    /// Returns the frames that these options ask to fit.
    pub fn frames(&self) -> FramesToFit {
        FramesToFit {
            base: self.fit_base,
            tools: self.fit_tool.is_some(),
            rows: self.fit_tool.flatten().map(|rows| rows as usize),
        }
    }
}

/// Noise of the instrument.
#[derive(Clone, Copy, Debug, Args)]
pub struct NoiseArgs {
    /// Standard deviation of one position component, as stated by the instrument's manufacturer (default: `sigma_mm` column,
    /// otherwise estimated).
    #[arg(long, value_name = "MM", value_parser = positive)]
    pub position_sigma_mm: Option<f64>,
    /// Standard deviation of one orientation component, as stated by the instrument's manufacturer (default: `sigma_mrad` column,
    /// otherwise estimated).
    #[arg(long, value_name = "MRAD", value_parser = positive)]
    pub orientation_sigma_mrad: Option<f64>,
}

impl NoiseArgs {
    /// Converts the stated noise of the instrument to SI units.
    pub fn instrument_noise(&self) -> InstrumentNoise {
        InstrumentNoise {
            position: self.position_sigma_mm.map(|x| 1e-3 * x),
            orientation: self.orientation_sigma_mrad.map(|x| 1e-3 * x),
        }
    }
}

impl FitArgs {
    /// Returns each option with whether it was given.
    pub fn given(&self) -> [(bool, &'static str); 9] {
        [
            (self.per_output, "--per-output"),
            (self.no_variance, "--no-variance"),
            (self.inducing_points.is_some(), "--inducing-points"),
            (self.gravity.is_some(), "--gravity"),
            (
                self.noise.position_sigma_mm.is_some(),
                "--position-sigma-mm",
            ),
            (
                self.noise.orientation_sigma_mrad.is_some(),
                "--orientation-sigma-mrad",
            ),
            (self.outliers.is_some(), "--outliers"),
            (self.warm_up.is_some(), "--warm-up"),
            (self.weighting.is_some(), "--weighting"),
        ]
    }

    /// Prints a note about options that none of `methods` reads.
    pub fn note_unused(&self, methods: &[Method]) {
        let of_paper = [Method::Poe, Method::PoeGp, Method::PoeGpLoad];
        let options = [
            (self.per_output, "--per-output", &of_paper[1..]),
            (self.weighting.is_some(), "--weighting", &of_paper[..]),
            (
                self.inducing_points.is_some(),
                "--inducing-points",
                &[Method::Elastic],
            ),
        ];
        for (is_given, name, readers) in options {
            if is_given && !readers.iter().any(|reader| methods.contains(reader)) {
                let readers: Vec<&str> = readers.iter().map(|reader| reader.name()).collect();
                let readers = readers.join(", ");
                note(format_args!(
                    "{name} has no effect: it is for --method {readers}"
                ));
            }
        }
    }

    /// Writes the options that were given into `config`.
    pub fn overlay(&self, config: &mut Config) {
        if self.per_output {
            config.hyperparameters = HyperparameterSharing::PerOutput;
        }
        if self.no_variance {
            config.device_variance = false;
        }
        if let Some(count) = self.inducing_points {
            config.inducing_points = count as usize;
        }
        if let Some(Gravity(gravity)) = self.gravity {
            config.gravity_m_s2 = gravity;
        }
        config.position_sigma_mm = self.noise.position_sigma_mm.or(config.position_sigma_mm);
        config.orientation_sigma_mrad = self
            .noise
            .orientation_sigma_mrad
            .or(config.orientation_sigma_mrad);
        config.warm_up = self.warm_up.unwrap_or(config.warm_up);
        config.outliers = self.outliers.unwrap_or(config.outliers);
        config.weighting = self.weighting.unwrap_or(config.weighting);
    }

    /// Creates the configuration of a calibration by `method`.
    pub fn config(&self, method: Method) -> Config {
        let mut config = Config::new(method);
        self.overlay(&mut config);
        config
    }
}

/// Returns the keys in which two configurations differ.
pub fn differences(old: &Config, new: &Config) -> Vec<&'static str> {
    let all = [
        ("method", old.method != new.method),
        ("weighting", old.weighting != new.weighting),
        (
            "hyperparameters",
            old.hyperparameters != new.hyperparameters,
        ),
        (
            "inducing_points",
            old.inducing_points != new.inducing_points,
        ),
        (
            "device_variance",
            old.device_variance != new.device_variance,
        ),
        ("outliers", old.outliers != new.outliers),
        ("warm_up", old.warm_up != new.warm_up),
        ("gravity_m_s2", old.gravity_m_s2 != new.gravity_m_s2),
        (
            "position_sigma_mm",
            old.position_sigma_mm != new.position_sigma_mm,
        ),
        (
            "orientation_sigma_mrad",
            old.orientation_sigma_mrad != new.orientation_sigma_mrad,
        ),
        (
            "max_correction_mm",
            old.max_correction_mm != new.max_correction_mm,
        ),
        (
            "max_correction_mrad",
            old.max_correction_mrad != new.max_correction_mrad,
        ),
    ];
    all.into_iter()
        .filter(|(_, differs)| *differs)
        .map(|(key, _)| key)
        .collect()
}

/// Gravity in the base frame, m/s².
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gravity(pub [f64; 3]);

/// Parses three numbers with commas between them.
pub fn gravity(text: &str) -> Result<Gravity, String> {
    let numbers: Result<Vec<f64>, _> = text.split(',').map(|x| x.trim().parse()).collect();
    let vector = numbers.ok().and_then(|v| <[f64; 3]>::try_from(v).ok());
    match vector {
        Some(g) if g.iter().all(|x| x.is_finite()) => Ok(Gravity(g)),
        _ => Err("expected three numbers in m/s², such as 0,0,-9.81".to_owned()),
    }
}

/// Parses a number above 0.
pub fn positive(text: &str) -> Result<f64, String> {
    match text.parse() {
        Ok(x) if x > 0.0 && f64::is_finite(x) => Ok(x),
        _ => Err("expected a number above 0".to_owned()),
    }
}

/// Parses a value of one of the library's enumerations by its name.
fn named<T: DeserializeOwned>(name: String) -> Result<T, value::Error> {
    T::deserialize(name.into_deserializer())
}

/// Returns the names of all methods with what each is.
pub fn methods() -> [PossibleValue; Method::ALL.len()] {
    Method::ALL.map(|method| PossibleValue::new(method.name()).help(method.about()))
}

/// Creates the parser of a calibration method.
pub fn method() -> impl TypedValueParser<Value = Method> {
    PossibleValuesParser::new(methods()).try_map(named)
}

/// A calibration method; `None` lets the training data choose it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MethodChoice(pub Option<Method>);

/// Creates the parser of a calibration method or `auto`.
pub fn method_or_auto() -> impl TypedValueParser<Value = MethodChoice> {
    let auto = PossibleValue::new("auto")
        .help("The simplest of base-tool, poe, parametric and elastic, with noise as weights, that is within one standard error of the best (two, with \
            fewer than 40 poses) in cross-validation of the training data");
    PossibleValuesParser::new(methods().into_iter().chain([auto])).try_map(|name| {
        match name.as_str() {
            "auto" => Ok(MethodChoice(None)),
            _ => named(name).map(|method| MethodChoice(Some(method))),
        }
    })
}

/// Creates the parser of one of the library's enumerations; each value has its name and its help.
fn described<T, const N: usize>(
    values: [(&'static str, &'static str); N],
) -> impl TypedValueParser<Value = T>
where
    T: DeserializeOwned + Clone + Send + Sync + 'static,
{
    let values = values.map(|(name, help)| PossibleValue::new(name).help(help));
    PossibleValuesParser::new(values).try_map(named)
}

fn weighting() -> impl TypedValueParser<Value = Weighting> {
    described([
        ("none", "Metres and radians count equally, as in the paper"),
        (
            "noise",
            "Residuals are divided by the noise; rotations are taken at the tool point",
        ),
    ])
}

fn warm_up() -> impl TypedValueParser<Value = WarmUpPolicy> {
    described([
        ("keep", "Train on the rows as they were measured"),
        (
            "remove",
            "Remove it from every row: the model describes the arm at the last row",
        ),
    ])
}

fn outliers() -> impl TypedValueParser<Value = OutlierPolicy> {
    described([
        ("keep", "Train on outliers as on all other measurements"),
        ("reject", "Leave outliers out of the training"),
    ])
}
