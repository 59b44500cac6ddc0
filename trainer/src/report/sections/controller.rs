//! The section for the engineer of the controller: the arm's parameters beside those of the nominal model, and signed errors.

use maud::{Markup, html};

use crate::report::controller::{BeforeAndAfter, Changed, ControllerSummary};
use crate::report::{Number, Section};
use poegp_calibration::validation::signed_residuals::Signed;

/// Number of decimals of degrees: a hundredth of a milliradian is 0.0006°.
const DEGREES: usize = 4;

/// Returns the section with Denavit-Hartenberg table, joint zeros and signed residuals.
pub fn controller(summary: Option<&ControllerSummary>) -> Section {
    let section = Section::new("controller", "For the controller's engineer");
    let Some(summary) = summary else {
        return section.missing("Not shown: there is no calibrated chain.");
    };
    let section = zeros(dh(section, summary), summary);
    match &summary.residuals {
        Some(residuals) => signed(section, summary, residuals),
        None => section.missing("Signed errors are not shown: no pose was held out."),
    }
}

fn dh(section: Section, summary: &ControllerSummary) -> Section {
    let has_beta = summary.dh.iter().any(|row| row.beta_deg.is_some());
    let has_std = summary.dh.iter().any(|row| row.a_mm.std.is_some());
    let distance = &summary.distance;
    let field = |row: usize, name: &str, decimals: usize, number: &Changed| {
        let at = |key: &str| format!("/controller/dh/{row}/{name}/{key}");
        html! {
            div {
                (Number::new(number.nominal, decimals, at("nominal"))) " → "
                b { (Number::new(number.calibrated, decimals, at("calibrated"))) }
            }
            div {
                @if number.difference >= 0.0 { "+" }
                (Number::new(number.difference, decimals, at("difference")))
                @if let Some(std) = number.std { " ± " (Number::new(std, decimals, at("std"))) }
            }
        }
    };
    let rows = summary.dh.iter().enumerate().map(|(i, row)| {
        let mut out = vec![
            html! { (row.joint) },
            field(i, "theta_deg", DEGREES, &row.theta_deg),
            field(i, "d_mm", 3, &row.d_mm),
            field(i, "a_mm", 3, &row.a_mm),
            field(i, "alpha_deg", DEGREES, &row.alpha_deg),
        ];
        if has_beta {
            out.push(match &row.beta_deg {
                Some(beta) => field(i, "beta_deg", DEGREES, beta),
                None => html! { "–" },
            });
        }
        out
    });
    let mut header = vec!["joint", "θ (°)", "d (mm)", "a (mm)", "α (°)"];
    if has_beta {
        header.push("β (°)");
    }
    section
        .text(html! {
            "Denavit-Hartenberg numbers: nominal → calibrated arm, and below the difference"
            @if has_std { " ± one standard deviation" } ". "
            "A row is R" sub { "z" } "(q + θ) T" sub { "z" } "(d) T" sub { "x" } "(a) R" sub { "x" } "(α)"
            @if has_beta {
                " R" sub { "y" } "(β); β stands in place of d where two axes are parallel, because d is not determined there"
            }
            ". The same table with base and flange is written by " code { "trainer export --dh" } "."
            @if !has_std { " Standard deviations are not known for this model." }
        })
        .table(&header, rows.collect())
        .text(html! {
            "How close these numbers come to the model: over the trained joint ranges, this table is on average "
            (Number::mm(distance.dh_mm, "/controller/distance/dh_mm")) " mm from the whole model, joint zeros alone "
            (Number::mm(distance.joint_zeros_mm, "/controller/distance/joint_zeros_mm")) " mm, and the nominal model "
            (Number::mm(distance.nominal_mm, "/controller/distance/nominal_mm")) " mm."
            @if distance.dh_mm >= distance.nominal_mm { " The nominal model is as near: do not enter the table." }
        })
}

fn zeros(section: Section, summary: &ControllerSummary) -> Section {
    if summary.joint_zeros.is_empty() {
        return section.missing(
            "Joint zeros alone are not shown: with them the nominal model is no nearer to the model than without. Do not enter any.",
        );
    }
    let rows = summary.joint_zeros.iter().enumerate().map(|(i, zero)| {
        let at = |key: &str| format!("/controller/joint_zeros/{i}/{key}");
        let offset = match (zero.offset_deg, zero.offset_mm) {
            (Some(deg), _) => html! { (Number::new(deg, DEGREES, at("offset_deg"))) "°" },
            (_, Some(mm)) => html! { (Number::mm(mm, at("offset_mm"))) " mm" },
            _ => html! { "–" },
        };
        let std = match zero.std {
            Some(std) if zero.offset_deg.is_some() => {
                html! { (Number::new(std, DEGREES, at("std"))) "°" }
            }
            Some(std) => html! { (Number::mm(std, at("std"))) " mm" },
            None => html! { "–" },
        };
        vec![html! { (zero.joint) }, offset, std]
    });
    section
        .text(html! {
            "Joint zeros alone: where the controller shows q, the arm has the pose of the nominal model at q + offset. The \
            first and the "
            "last joint have none, because base and tool do the same. " code { "trainer export --joint-offsets" }
            " writes them with the base and the tool that belong to them."
        })
        .table(
            &["joint", "offset", "standard deviation"],
            rows.collect(),
        )
}

fn signed(section: Section, summary: &ControllerSummary, residuals: &BeforeAndAfter) -> Section {
    let BeforeAndAfter { before, after } = residuals;
    let pair = |name: Markup, unit: &str, part: String, before: &Signed, after: &Signed| {
        let field = |when: &str, value: &Signed| {
            let at = |key: &str| format!("/controller/residuals/{when}/{part}/{key}");
            html! { (Number::new(value.mean, 3, at("mean"))) " ± " (Number::new(value.std, 3, at("std"))) " " (unit) }
        };
        vec![name, field("before", before), field("after", after)]
    };
    let mut rows = Vec::new();
    for (axis, name) in ["x", "y", "z"].into_iter().enumerate() {
        let part = format!("axes_mm/{axis}");
        let values = (&before.axes_mm[axis], &after.axes_mm[axis]);
        rows.push(pair(
            html! { "along " (name) },
            "mm",
            part,
            values.0,
            values.1,
        ));
    }
    if let (Some(before), Some(after)) = (&before.axes_mrad, &after.axes_mrad) {
        for (axis, name) in ["x", "y", "z"].into_iter().enumerate() {
            let part = format!("axes_mrad/{axis}");
            rows.push(pair(
                html! { "about " (name) },
                "mrad",
                part,
                &before[axis],
                &after[axis],
            ));
        }
    }
    for (i, joint) in summary.dh.iter().enumerate() {
        let (part, unit) = (format!("joints/{i}"), joint.residual_unit);
        let values = (&before.joints[i], &after.joints[i]);
        rows.push(pair(
            html! { (joint.joint) },
            unit,
            part,
            values.0,
            values.1,
        ));
    }
    section
        .text(html! {
            "Errors with their signs, measured less predicted, of the held-out poses: mean ± standard deviation of single poses, in "
            "the axes of the robot's base. A mean that is large beside the other numbers is a shift that everything shares. The error "
            "of a joint is the change of that joint alone that would explain as much of the error as possible at each \
             pose; "
            "several joints may explain the same error."
        })
        .table(
            &["", "before: nominal model, base and tool fitted", "after"],
            rows,
        )
}
