//! The tables of a map as they stand in its TOML.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use toml::Spanned;

/// A column by its name in the header, or by its number from 1.
#[derive(Clone, Debug, Deserialize, PartialEq, Eq)]
#[serde(
    untagged,
    expecting = "no name and no number of a column, expected one or the other"
)]
pub enum ColumnName {
    /// From 1.
    Number(usize),
    /// As the header has it, spaces around it aside.
    Name(String),
}

/// How the text of a file is laid out.
#[derive(Clone, Debug, Deserialize, Serialize, PartialEq, Eq)]
#[serde(deny_unknown_fields, default)]
pub struct Layout {
    /// What is between two cells.
    pub separator: Separator,
    /// The decimal point.
    pub decimal: Decimal,
    /// What groups digits of thousands, and is taken out.
    pub thousands: Option<char>,
    /// How bytes are letters.
    pub encoding: Encoding,
    /// The sheet of a spreadsheet that has several.
    pub sheet: Option<String>,
    /// Lines at the beginning that are not looked at.
    pub skip_lines: usize,
    /// Lines at the end that are not looked at.
    pub skip_last_lines: usize,
    /// Lines of the header: the first has names, the second units. 0: columns are numbers.
    pub header_lines: usize,
    /// Lines that begin so are not looked at.
    pub comments: Vec<String>,
}

impl Default for Layout {
    fn default() -> Self {
        Self {
            separator: Separator::Comma,
            decimal: Decimal::Point,
            thousands: None,
            encoding: Encoding::Utf8,
            sheet: None,
            skip_lines: 0,
            skip_last_lines: 0,
            header_lines: 1,
            comments: vec!["#".to_owned()],
        }
    }
}

/// What is between two cells.
#[derive(Clone, Copy, Debug, Deserialize, Serialize, PartialEq, Eq)]
#[serde(rename_all = "kebab-case")]
pub enum Separator {
    /// `,`
    #[serde(alias = ",")]
    Comma,
    /// `;`
    #[serde(alias = ";")]
    Semicolon,
    /// One tabulator.
    #[serde(alias = "\t")]
    Tab,
    /// Any number of spaces and tabulators.
    #[serde(alias = " ")]
    Space,
}

/// The decimal point.
#[derive(Clone, Copy, Debug, Deserialize, Serialize, PartialEq, Eq)]
pub enum Decimal {
    /// `.`
    #[serde(rename = ".", alias = "point")]
    Point,
    /// `,`
    #[serde(rename = ",", alias = "comma")]
    Comma,
}

/// How bytes are letters.
#[derive(Clone, Copy, Debug, Deserialize, Serialize, PartialEq, Eq)]
pub enum Encoding {
    /// With or without byte order mark.
    #[serde(rename = "utf-8")]
    Utf8,
    /// ISO 8859-1, and near enough Windows-1252: only names and comments have such letters.
    #[serde(rename = "latin-1", alias = "windows-1252")]
    Latin1,
    /// With byte order mark.
    #[serde(rename = "utf-16")]
    Utf16,
}

/// A unit of length.
#[derive(Clone, Copy, Debug, Deserialize, PartialEq, Eq)]
#[serde(rename_all = "lowercase")]
pub enum LengthUnit {
    /// Millimetre.
    Mm,
    /// Metre.
    M,
    /// Micrometre.
    Um,
    /// Inch, 25.4 mm.
    In,
}

impl LengthUnit {
    /// Millimetres of one.
    pub fn in_mm(self) -> f64 {
        match self {
            Self::Mm => 1.0,
            Self::M => 1e3,
            Self::Um => 1e-3,
            Self::In => 25.4,
        }
    }
}

/// A unit of angle.
#[derive(Clone, Copy, Debug, Deserialize, PartialEq, Eq)]
#[serde(rename_all = "lowercase")]
pub enum AngleUnit {
    /// Degree.
    Deg,
    /// Radian.
    Rad,
    /// Milliradian.
    Mrad,
}

/// The unit of a joint.
#[derive(Clone, Copy, Debug, Deserialize, PartialEq, Eq)]
#[serde(rename_all = "lowercase")]
pub enum JointUnit {
    /// Degree.
    Deg,
    /// Radian.
    Rad,
    /// Millimetre, of a prismatic joint.
    Mm,
    /// Metre, of a prismatic joint.
    M,
}

/// One unit for all joints, or one for each.
#[derive(Clone, Debug, Deserialize, PartialEq, Eq)]
#[serde(
    untagged,
    expecting = "another unit, expected \"deg\", \"rad\", \"mm\", \"m\", or a list of them for the joints"
)]
pub enum JointUnits {
    /// For all.
    All(JointUnit),
    /// Base first.
    Each(Vec<JointUnit>),
}

/// The joints as they stand in the map; which keys go together is checked afterwards.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct JointTable {
    pub(super) columns: Option<Spanned<Vec<ColumnName>>>,
    pub(super) driver: Option<Spanned<String>>,
    pub(super) unit: Option<Spanned<JointUnits>>,
    pub(super) name: Option<Spanned<ColumnName>>,
}

/// The joints as commanded.
#[derive(Clone, Debug)]
pub struct Joints {
    /// Where they are.
    pub source: JointSource,
    /// Their units; without them the header or the driver has them.
    pub unit: Option<Spanned<JointUnits>>,
    /// The column with the pose's name, in a file of joints beside a list of points.
    pub name: Option<Spanned<ColumnName>>,
}

/// Where the joints are.
#[derive(Clone, Debug)]
pub enum JointSource {
    /// Base first.
    Columns(Spanned<Vec<ColumnName>>),
    /// Where the driver with this name writes them.
    Driver(Spanned<String>),
}

/// x, y, z.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Position {
    /// x, y, z.
    pub columns: Spanned<Vec<ColumnName>>,
    /// Their unit; without it the header has it.
    pub unit: Option<LengthUnit>,
}

/// How an orientation is written.
#[derive(Clone, Copy, Debug, Deserialize, PartialEq, Eq)]
#[serde(rename_all = "kebab-case")]
pub(super) enum OrientationKind {
    Quaternion,
    Euler,
    RotationVector,
    Matrix,
}

/// The keys of all kinds; which of them belong is checked afterwards, so that messages have a place.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct OrientationTable {
    pub(super) kind: OrientationKind,
    pub(super) columns: Spanned<Vec<ColumnName>>,
    pub(super) order: Option<Spanned<String>>,
    pub(super) axes: Option<Spanned<EulerAxes>>,
    pub(super) unit: Option<Spanned<AngleUnit>>,
    pub(super) layout: Option<Spanned<MatrixLayout>>,
}

/// instrument_from_target, rotation.
#[derive(Clone, Debug)]
pub enum Orientation {
    /// A unit quaternion.
    Quaternion {
        /// In the order of `order`.
        columns: Spanned<Vec<ColumnName>>,
        /// Where w stands.
        order: QuaternionOrder,
    },
    /// Three angles.
    Euler {
        /// In the order of `order`.
        columns: Spanned<Vec<ColumnName>>,
        /// The axes, three letters.
        order: Spanned<String>,
        /// Whether the axes turn with the body.
        axes: EulerAxes,
        /// Unit of the angles; without it the header has it.
        unit: Option<AngleUnit>,
    },
    /// Axis times angle.
    RotationVector {
        /// x, y, z.
        columns: Spanned<Vec<ColumnName>>,
        /// Unit of its length; without it the header has it.
        unit: Option<AngleUnit>,
    },
    /// Nine numbers.
    Matrix {
        /// Row by row, unless `layout` says otherwise.
        columns: Spanned<Vec<ColumnName>>,
        /// Which way they are counted.
        layout: MatrixLayout,
    },
}

/// Where w stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum QuaternionOrder {
    /// First.
    Wxyz,
    /// Last.
    Xyzw,
}

/// Whether the axes turn with the body.
#[derive(Clone, Copy, Debug, Deserialize, PartialEq, Eq)]
#[serde(rename_all = "lowercase")]
pub enum EulerAxes {
    /// They turn: each angle is about an axis that the angles before have turned.
    Intrinsic,
    /// They stay.
    Extrinsic,
}

/// Which way the numbers of a matrix are counted.
#[derive(Clone, Copy, Debug, Default, Deserialize, PartialEq, Eq)]
#[serde(rename_all = "lowercase")]
pub enum MatrixLayout {
    /// Row by row.
    #[default]
    Rows,
    /// Column by column.
    Columns,
}

/// instrument_from_target as one matrix.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PoseMatrix {
    /// Twelve or sixteen numbers: 3×4, or 4×4 with 0 0 0 1.
    pub columns: Spanned<Vec<ColumnName>>,
    /// Unit of the translation; without it the header has it.
    pub unit: Option<LengthUnit>,
    /// Which way they are counted.
    #[serde(default)]
    pub layout: MatrixLayout,
}

/// A text: a column, or the same in every row.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Label {
    /// The column.
    pub column: Option<Spanned<ColumnName>>,
    /// The text of every row.
    pub value: Option<Spanned<String>>,
}

/// The mass at the flange.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Payload {
    /// The column.
    pub column: Option<Spanned<ColumnName>>,
    /// The same in every row.
    pub value: Option<Spanned<f64>>,
    /// Its unit; without it the header has it.
    pub unit: Option<MassUnit>,
}

/// A unit of mass.
#[derive(Clone, Copy, Debug, Deserialize, PartialEq, Eq)]
#[serde(rename_all = "lowercase")]
pub enum MassUnit {
    /// Kilogram.
    Kg,
    /// Gram.
    G,
}

/// The instrument's standard uncertainty of a position component.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SigmaPosition {
    /// The column.
    pub column: Spanned<ColumnName>,
    /// Its unit; without it the header has it.
    pub unit: Option<LengthUnit>,
}

/// The instrument's standard uncertainty of a rotation component.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SigmaOrientation {
    /// The column.
    pub column: Spanned<ColumnName>,
    /// Its unit; without it the header has it.
    pub unit: Option<AngleUnit>,
}

/// A list of points, several to a pose.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Points {
    /// The column with the point's name, or with the pose's.
    pub name: Spanned<ColumnName>,
    /// The column with the name of the target, where it is not part of `name`.
    pub target: Option<Spanned<ColumnName>>,
    /// What is between pose and target in `name`: `P12_A` is target A of pose P12 by "_". The last one counts.
    pub split: Option<Spanned<String>>,
    /// x, y, z.
    pub columns: Spanned<Vec<ColumnName>>,
    /// Unit of the points; without it the header has it.
    pub unit: Option<LengthUnit>,
    /// How poses find their joints.
    pub join: Join,
    /// Largest distance of a point from where the fit puts it.
    pub max_residual_mm: Option<Spanned<f64>>,
    /// Where the targets are on the tool; without it every point is a measurement of a position alone.
    pub targets: Option<Spanned<BTreeMap<String, [f64; 3]>>>,
    /// Unit of `targets`.
    pub targets_unit: Option<LengthUnit>,
}

/// How poses find their joints.
#[derive(Clone, Copy, Debug, Deserialize, PartialEq, Eq)]
#[serde(rename_all = "lowercase")]
pub enum Join {
    /// By the name of the pose, which is in `joints.name`, too.
    Name,
    /// The first pose of the points has the first row of the joints, and so on.
    Order,
}

/// Three reflectors or more in every row.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Reflectors {
    /// x, y, z of each.
    pub columns: Spanned<Vec<Vec<ColumnName>>>,
    /// Unit of the columns; without it the header has it.
    pub unit: Option<LengthUnit>,
    /// Where each is on the tool.
    pub at: Spanned<Vec<[f64; 3]>>,
    /// Unit of `at`.
    pub at_unit: LengthUnit,
    /// Largest distance of a reflector from where the fit puts it.
    pub max_residual_mm: Option<Spanned<f64>>,
}

/// How a file of joints is joined to a file of poses.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FileJoin {
    /// What decides.
    pub by: JoinBy,
    /// The column of the poses.
    pub poses: Option<Spanned<ColumnName>>,
    /// The column of the joints.
    pub joints: Option<Spanned<ColumnName>>,
    /// Unit of the poses' time; without it the header has it.
    pub poses_unit: Option<TimeUnit>,
    /// Unit of the joints' time; without it the header has it.
    pub joints_unit: Option<TimeUnit>,
    /// Largest time between a pose and its joints.
    pub tolerance_s: Option<Spanned<f64>>,
}

/// What decides which row of joints belongs to a pose.
#[derive(Clone, Copy, Debug, Deserialize, PartialEq, Eq)]
#[serde(rename_all = "lowercase")]
pub enum JoinBy {
    /// The first row has the first, and so on.
    Order,
    /// A number or a name in both.
    Index,
    /// The clock, which both share.
    Time,
}

/// A unit of time.
#[derive(Clone, Copy, Debug, Deserialize, PartialEq, Eq)]
#[serde(rename_all = "lowercase")]
pub enum TimeUnit {
    /// Second.
    S,
    /// Millisecond.
    Ms,
    /// No unit: date and time of day, `2026-11-23T14:05:09.125Z`.
    Iso8601,
}

/// What is done with rows that are not whole.
#[derive(Clone, Copy, Debug, Default, Deserialize, PartialEq, Eq)]
#[serde(rename_all = "kebab-case")]
pub enum Incomplete {
    /// They are refused.
    #[default]
    Refuse,
    /// They are left out and listed.
    LeaveOut,
}

/// The whole file.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Tables {
    #[serde(default)]
    pub(super) file: Layout,
    pub(super) joints_file: Option<Layout>,
    #[serde(default)]
    pub(super) incomplete: Incomplete,
    pub(super) joints: Spanned<JointTable>,
    pub(super) position: Option<Position>,
    pub(super) orientation: Option<Spanned<OrientationTable>>,
    pub(super) pose: Option<PoseMatrix>,
    pub(super) points: Option<Points>,
    pub(super) reflectors: Option<Reflectors>,
    pub(super) join: Option<FileJoin>,
    pub(super) payload: Option<Payload>,
    pub(super) session: Option<Label>,
    pub(super) target: Option<Label>,
    pub(super) sigma_position: Option<SigmaPosition>,
    pub(super) sigma_orientation: Option<SigmaOrientation>,
    #[serde(default)]
    pub(super) reference: Vec<Position>,
}
