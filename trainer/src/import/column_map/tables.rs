//! The tables of a map as its TOML has them.

use std::collections::BTreeMap;

use poegp_calibration::robot::toml_source::Numbers;
use serde::{Deserialize, Serialize};
use toml::Spanned;

use crate::import::column_map::units::{AngleUnit, JointUnits, LengthUnit, MassUnit, TimeUnit};

/// A column by its name in the header, or by its number from 1.
#[derive(Clone, Debug, Deserialize, PartialEq, Eq)]
#[serde(
    untagged,
    expecting = "no name and no number of a column, expected one or the other"
)]
pub enum ColumnName {
    /// Number of the column, from 1.
    Number(usize),
    /// Name as in the header, without the spaces around it.
    Name(String),
}

/// Layout of the text of a file.
#[derive(Clone, Debug, Deserialize, Serialize, PartialEq, Eq)]
#[serde(deny_unknown_fields, default)]
pub struct Layout {
    /// Separator of two fields.
    pub separator: Separator,
    /// Decimal mark.
    pub decimal: Decimal,
    /// Character that groups digits in thousands; it is removed.
    pub thousands: Option<char>,
    /// Character encoding.
    pub encoding: Encoding,
    /// Name of the sheet, for a spreadsheet that has several.
    pub sheet: Option<String>,
    /// Number of lines to skip at the beginning.
    pub skip_lines: usize,
    /// Number of lines to skip at the end.
    pub skip_last_lines: usize,
    /// Number of lines of the header: the first has names, the second units. With 0, columns are named by their numbers.
    pub header_lines: usize,
    /// Beginnings of lines that are skipped as comments.
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

/// Separator of two fields.
#[derive(Clone, Copy, Debug, Deserialize, Serialize, PartialEq, Eq)]
#[serde(rename_all = "kebab-case")]
pub enum Separator {
    /// `,`
    #[serde(alias = ",")]
    Comma,
    /// `;`
    #[serde(alias = ";")]
    Semicolon,
    /// One tab.
    #[serde(alias = "\t")]
    Tab,
    /// Any number of spaces and tabs.
    #[serde(alias = " ")]
    Space,
}

/// Decimal mark.
#[derive(Clone, Copy, Debug, Deserialize, Serialize, PartialEq, Eq)]
pub enum Decimal {
    /// `.`
    #[serde(rename = ".", alias = "point")]
    Point,
    /// `,`
    #[serde(rename = ",", alias = "comma")]
    Comma,
}

/// Character encoding.
#[derive(Clone, Copy, Debug, Deserialize, Serialize, PartialEq, Eq)]
pub enum Encoding {
    /// UTF-8 with or without byte order mark.
    #[serde(rename = "utf-8")]
    Utf8,
    /// ISO 8859-1. It is near enough to Windows-1252: only names and comments have the letters that differ.
    #[serde(rename = "latin-1", alias = "windows-1252")]
    Latin1,
    /// UTF-16 with byte order mark.
    #[serde(rename = "utf-16")]
    Utf16,
}

/// The joints as the TOML has them; which keys go together is checked afterwards.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct JointTable {
    pub(super) columns: Option<Spanned<Vec<ColumnName>>>,
    pub(super) driver: Option<Spanned<String>>,
    pub(super) unit: Option<Spanned<JointUnits>>,
    pub(super) name: Option<Spanned<ColumnName>>,
}

/// The commanded joints.
#[derive(Clone, Debug)]
pub struct Joints {
    /// Where the columns of the joints are.
    pub source: JointSource,
    /// Units of the joints; `None` where the header or the driver states them.
    pub unit: Option<Spanned<JointUnits>>,
    /// Column with the name of the pose, in a file of joints that belongs to a list of points.
    pub name: Option<Spanned<ColumnName>>,
}

/// Where the columns of the joints are.
#[derive(Clone, Debug)]
pub enum JointSource {
    /// Columns by name or number, base first.
    Columns(Spanned<Vec<ColumnName>>),
    /// Columns that the driver with this name writes.
    Driver(Spanned<String>),
}

/// Columns of a position.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Position {
    /// Columns of x, y and z.
    pub columns: Spanned<Vec<ColumnName>>,
    /// Unit of the position; `None` where the header states it.
    pub unit: Option<LengthUnit>,
}

/// Notation of an orientation.
#[derive(Clone, Copy, Debug, Deserialize, PartialEq, Eq)]
#[serde(rename_all = "kebab-case")]
pub(super) enum OrientationKind {
    Quaternion,
    Euler,
    RotationVector,
    Matrix,
}

/// The keys of all notations; which of them belong together is checked afterwards, so that messages can name a line.
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

/// Columns of the rotation of `instrument_from_target`.
#[derive(Clone, Debug)]
pub enum Orientation {
    /// A unit quaternion.
    Quaternion {
        /// Columns in the order that `order` says.
        columns: Spanned<Vec<ColumnName>>,
        /// Position of w among the components.
        order: QuaternionOrder,
    },
    /// Three angles.
    Euler {
        /// Columns in the order that `order` says.
        columns: Spanned<Vec<ColumnName>>,
        /// The three axes, one letter each.
        order: Spanned<String>,
        /// Whether the axes turn with the body.
        axes: EulerAxes,
        /// Unit of the angles; `None` where the header states it.
        unit: Option<AngleUnit>,
    },
    /// A rotation vector: axis times angle.
    RotationVector {
        /// Columns of x, y and z.
        columns: Spanned<Vec<ColumnName>>,
        /// Unit of the vector's length; `None` where the header states it.
        unit: Option<AngleUnit>,
    },
    /// Nine elements of a rotation matrix.
    Matrix {
        /// Columns row by row, unless `layout` says otherwise.
        columns: Spanned<Vec<ColumnName>>,
        /// Order of the elements.
        layout: MatrixLayout,
    },
}

/// Position of w among the components of a quaternion.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum QuaternionOrder {
    /// w comes first.
    Wxyz,
    /// w comes last.
    Xyzw,
}

/// Whether the axes turn with the body.
#[derive(Clone, Copy, Debug, Deserialize, PartialEq, Eq)]
#[serde(rename_all = "lowercase")]
pub enum EulerAxes {
    /// The axes turn: each angle is about an axis that the angles before have turned.
    Intrinsic,
    /// The axes stay fixed.
    Extrinsic,
}

/// Order of the elements of a matrix.
#[derive(Clone, Copy, Debug, Default, Deserialize, PartialEq, Eq)]
#[serde(rename_all = "lowercase")]
pub enum MatrixLayout {
    /// Row by row.
    #[default]
    Rows,
    /// Column by column.
    Columns,
}

/// `instrument_from_target` as one matrix.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PoseMatrix {
    /// Columns of twelve or sixteen elements: 3×4, or 4×4 with the last row 0 0 0 1.
    pub columns: Spanned<Vec<ColumnName>>,
    /// Unit of the translation; `None` where the header states it.
    pub unit: Option<LengthUnit>,
    /// Order of the elements.
    #[serde(default)]
    pub layout: MatrixLayout,
}

/// A text: from a column, or one text for every row.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Label {
    /// Column with the text.
    pub column: Option<Spanned<ColumnName>>,
    /// Text that every row has.
    pub value: Option<Spanned<String>>,
}

/// The mass at the flange.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Payload {
    /// Column with the mass.
    pub column: Option<Spanned<ColumnName>>,
    /// Mass that every row has.
    pub value: Option<Spanned<f64>>,
    /// Unit of the mass; `None` where the header states it.
    pub unit: Option<MassUnit>,
}

/// The instrument's standard uncertainty of a position component.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SigmaPosition {
    /// Column with the uncertainty.
    pub column: Spanned<ColumnName>,
    /// Unit of the uncertainty; `None` where the header states it.
    pub unit: Option<LengthUnit>,
}

/// The instrument's standard uncertainty of a rotation component.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SigmaOrientation {
    /// Column with the uncertainty.
    pub column: Spanned<ColumnName>,
    /// Unit of the uncertainty; `None` where the header states it.
    pub unit: Option<AngleUnit>,
}

/// Columns of a list of points, several of them for each pose.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Points {
    /// Column with the name of the point, or with the name of the pose.
    pub name: Spanned<ColumnName>,
    /// Column with the name of the target, where it is not part of `name`.
    pub target: Option<Spanned<ColumnName>>,
    /// Separator of pose and target in `name`: with "_", `P12_A` is target A of pose P12. The last occurrence counts.
    pub split: Option<Spanned<String>>,
    /// Columns of x, y and z.
    pub columns: Spanned<Vec<ColumnName>>,
    /// Unit of the points; `None` where the header states it.
    pub unit: Option<LengthUnit>,
    /// How poses are joined to their joints.
    pub join: Join,
    /// Largest residual of a point in the fit of a pose, in mm.
    pub max_residual_mm: Option<Spanned<f64>>,
    /// Positions of the targets on the tool; without them every point is a measurement of a position alone.
    pub targets: Option<Spanned<BTreeMap<String, Numbers<3>>>>,
    /// Unit of `targets`.
    pub targets_unit: Option<LengthUnit>,
}

/// How poses are joined to their joints.
#[derive(Clone, Copy, Debug, Deserialize, PartialEq, Eq)]
#[serde(rename_all = "lowercase")]
pub enum Join {
    /// By the name of the pose, which is also in the column `joints.name`.
    Name,
    /// By order: the first pose of the points has the first row of the joints, and so on.
    Order,
}

/// Columns of three or more reflectors in every row.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Reflectors {
    /// Columns of x, y and z of each reflector.
    pub columns: Spanned<Vec<Vec<ColumnName>>>,
    /// Unit of the columns; `None` where the header states it.
    pub unit: Option<LengthUnit>,
    /// Position of each reflector on the tool.
    pub at: Spanned<Vec<Numbers<3>>>,
    /// Unit of `at`.
    pub at_unit: LengthUnit,
    /// Largest residual of a reflector in the fit of a pose, in mm.
    pub max_residual_mm: Option<Spanned<f64>>,
}

/// How a file of joints is joined to a file of poses.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FileJoin {
    /// Criterion of the join.
    pub by: JoinBy,
    /// Index or time column of the file of poses.
    pub poses: Option<Spanned<ColumnName>>,
    /// Index or time column of the file of joints.
    pub joints: Option<Spanned<ColumnName>>,
    /// Unit of the poses' time; `None` where the header states it.
    pub poses_unit: Option<TimeUnit>,
    /// Unit of the joints' time; `None` where the header states it.
    pub joints_unit: Option<TimeUnit>,
    /// Largest time between a pose and its joints, in seconds.
    pub tolerance_s: Option<Spanned<f64>>,
}

/// Criterion that decides which row of joints belongs to a pose.
#[derive(Clone, Copy, Debug, Deserialize, PartialEq, Eq)]
#[serde(rename_all = "lowercase")]
pub enum JoinBy {
    /// By order: the first row of poses has the first row of joints, and so on.
    Order,
    /// By an index: a number or a name that both files have.
    Index,
    /// By time: both files have the same clock.
    Time,
}

/// When a row was measured.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Time {
    /// Column with the time.
    pub column: Spanned<ColumnName>,
    /// Unit of the time; `None` where the header states it.
    pub unit: Option<TimeUnit>,
}

/// What happens to incomplete rows.
#[derive(Clone, Copy, Debug, Default, Deserialize, PartialEq, Eq)]
#[serde(rename_all = "kebab-case")]
pub enum Incomplete {
    /// Incomplete rows are refused.
    #[default]
    Refuse,
    /// Incomplete rows are left out and listed.
    LeaveOut,
}

/// The whole TOML file of a map.
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
    pub(super) time: Option<Time>,
    pub(super) session: Option<Label>,
    pub(super) target: Option<Label>,
    pub(super) sigma_position: Option<SigmaPosition>,
    pub(super) sigma_orientation: Option<SigmaOrientation>,
    #[serde(default)]
    pub(super) reference: Vec<Position>,
}
