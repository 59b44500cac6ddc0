//! The table of the poses, from which plots take the description of a dot.

use maud::{Markup, html};
use poegp_protocol::JointKind;

use crate::report::data::DRAWN;
use crate::report::{Column, ReportData, Section, rounded};

/// Returns the unit of a joint, its factor from rad or m, and its number of decimals.
pub fn joint_unit(kind: JointKind) -> (&'static str, f64, usize) {
    match kind {
        JointKind::Revolute => ("deg", 180.0 / std::f64::consts::PI, 2),
        JointKind::Prismatic => ("mm", 1e3, 2),
    }
}

/// Returns one column for each joint.
pub fn joint_columns(kinds: &[JointKind]) -> impl Iterator<Item = Column> {
    let unit = |(i, kind): (usize, &JointKind)| Column::Joint(i + 1, joint_unit(*kind).0);
    kinds.iter().enumerate().map(unit)
}

/// Returns the values of the columns of [`joint_columns`].
pub fn joint_fields(kinds: &[JointKind], joints: &[f64]) -> impl Iterator<Item = Markup> {
    let value = |(value, kind): (&f64, &JointKind)| {
        let (_, factor, decimals) = joint_unit(*kind);
        html! { (rounded(factor * value, decimals)) }
    };
    joints.iter().zip(kinds).map(value)
}

/// Returns a sentence for plots that leave poses out; empty where they show all.
pub fn left_out(all: usize) -> String {
    if all <= DRAWN {
        return String::new();
    }
    format!(
        " Of {all} poses the plots have dots for {DRAWN}: a tenth of them are those with the largest errors, the others are \
         evenly spread over the rows. Lines, arrows and numbers are of all poses."
    )
}

/// Returns the section with every pose that the plots show: line, errors, joints, payload, session.
pub fn poses(evidence: &ReportData) -> Section {
    let both = evidence.nominal != evidence.calibrated;
    let several = evidence.parts(|row| row.file.clone()).len() > 1;
    let (before, after) = (&evidence.nominal().poses, &evidence.calibrated().poses);
    let shown = evidence.drawn();
    let rotated = after.iter().any(|p| p.error.orientation_mrad.is_some());
    let loaded = evidence.rows.iter().any(|row| row.payload_kg.is_some());
    let sessions = evidence.rows.iter().any(|row| !row.tool.is_empty());
    let mut columns = vec![
        Column::Name("row".into()),
        Column::Error("position error (mm)".into()),
    ];
    let mut more = |wanted: bool, name: &str| {
        columns.extend(wanted.then(|| Column::Other(name.to_owned())));
    };
    more(both, "before (mm)");
    more(rotated, "orientation error (mrad)");
    more(loaded, "payload (kg)");
    more(sessions, "session, target");
    columns.extend(joint_columns(&evidence.kinds));
    let row = |i: &usize| {
        let (i, row) = (*i, &evidence.rows[*i]);
        let mut fields = vec![
            html! { @if several { (row.file) " " } "line " (row.line) },
            html! { (rounded(after[i].error.position_mm, 4)) },
        ];
        let mut more = |wanted: bool, field: Markup| fields.extend(wanted.then_some(field));
        more(both, html! { (rounded(before[i].error.position_mm, 4)) });
        let rotation = after[i].error.orientation_mrad;
        more(
            rotated,
            html! { @if let Some(mrad) = rotation { (rounded(mrad, 3)) } },
        );
        more(loaded, html! { @if let Some(kg) = row.payload_kg { (kg) } });
        more(sessions, html! { (row.tool) });
        fields.extend(joint_fields(&evidence.kinds, &row.joints));
        fields
    };
    let rows: Vec<Vec<Markup>> = shown.iter().map(row).collect();
    let all = evidence.rows.len();
    let title = if rows.len() < all {
        format!("{} of {all} poses", rows.len())
    } else if all == 1 {
        "The pose".to_owned()
    } else {
        format!("All {all} poses")
    };
    Section::new("all-poses", "Pose by pose")
        .text(html! { "What the plots show for a dot: its line in the file, its errors and its joints." (left_out(all)) })
        .poses(&columns, rows, Some(&title))
}
