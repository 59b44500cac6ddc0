//! The refusal of a file with a mistake in all of its rows, as text for the user.

use poegp_protocol::JointKind;
use poegp_protocol::cause::Cause;

use crate::identification::touch::fit::{TouchFit, TouchProblem};
use crate::identification::touch::mistakes::{Explained, Mistake};
use crate::model::touches::summary::unit;
use crate::robot::Robot;
use crate::trust::wording::{fits_equally, three_digits};
use crate::trust::{Finding, Tier};

/// Returns the finding about a mistake.
pub fn mistaken(robot: &Robot, explained: &Explained) -> Finding {
    let (unit, factor) = unit(explained.kind);
    let [given, left] = explained.scatter.map(|x| three_digits(factor * x));
    let others: Vec<String> = explained.others.iter().map(|m| named(robot, m)).collect();
    let others = fits_equally(&others);
    let text = format!(
        "{}: the touches miss by {given} {unit} as given and by {left} {unit} then{others}",
        named(robot, &explained.mistake)
    );
    let cause = match explained.mistake {
        Mistake::Sign(_) => Cause::Sign,
        Mistake::Swap(..) => Cause::Swap,
        Mistake::Unit | Mistake::UnitOf(_) => Cause::Unit,
        Mistake::Offset(..) => Cause::Offset,
        Mistake::Robot(_) => Cause::Robot,
        Mistake::Rows(_) => Cause::Rows,
        Mistake::Pixels => Cause::Swap,
    };
    let [given, left] = explained.scatter;
    Finding::new(cause, Tier::Refused, text, left / given.max(1e-12), 1.0)
}

/// Returns the finding about a joint zero that has a prior of its own.
pub fn lost(robot: &Robot, problem: &TouchProblem, fit: &TouchFit) -> Option<Finding> {
    let columns = fit.arm.columns.iter().zip(&fit.arm.theta);
    let (column, zero) = columns
        .into_iter()
        .find(|(column, _)| problem.is_lost(column))?;
    let stated = problem.class.joint_zero;
    let times = zero.abs() / stated;
    let by = match robot.joints[column.index].kind {
        JointKind::Revolute => format!("{} mrad", three_digits(1e3 * zero.abs())),
        JointKind::Prismatic => format!("{} mm", three_digits(1e3 * zero.abs())),
    };
    let joint = column.index + 1;
    // A tip that is turned about the last joint is as far from where it is stated.
    let tip = match joint == robot.joints.len() {
        true => {
            "measure tip_mm again, for a tip that is turned about this joint looks the same; then "
        }
        false => "",
    };
    let text = format!(
        "the zero of joint {joint} is {by} from the nominal model, {times:.0} times the {} of joint_zero_mrad: it was fitted without \
         that prior; {tip}master joint {joint} again, or state a larger [prior] joint_zero_mrad",
        three_digits(1e3 * stated)
    );
    Some(Finding::new(Cause::Frames, Tier::Warning, text, times, 1.0))
}

fn named(robot: &Robot, mistake: &Mistake) -> String {
    match mistake {
        Mistake::Sign(joint) => format!("joint {} looks reversed (its sign)", joint + 1),
        Mistake::Swap(a, b) => format!(
            "the columns of joints {} and {} look exchanged",
            a + 1,
            b + 1
        ),
        Mistake::Unit => "the joints look like radians where the header says degrees".to_owned(),
        Mistake::UnitOf(joint) => {
            let (found, stated) = match robot.joints[*joint].kind {
                JointKind::Revolute => ("radians", "degrees"),
                JointKind::Prismatic => ("metres", "millimetres"),
            };
            let joint = joint + 1;
            format!("the column of joint {joint} looks like {found} where the header says {stated}")
        }
        Mistake::Offset(joint, by) => {
            let by = match robot.joints[*joint].kind {
                JointKind::Revolute => format!("{}°", three_digits(by.to_degrees().abs())),
                JointKind::Prismatic => format!("{} mm", three_digits(1e3 * by.abs())),
            };
            format!("the zero of joint {} looks off by {by}", joint + 1)
        }
        Mistake::Robot(name) => format!("the touches look like those of {name}"),
        Mistake::Rows(by) => format!(
            "each reading looks like that of the row {} it",
            match by.is_negative() {
                true => "before",
                false => "after",
            }
        ),
        Mistake::Pixels => "the columns u_px and v_px look exchanged".to_owned(),
    }
}
