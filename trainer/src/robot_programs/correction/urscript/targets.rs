//! Reads URScript's targets: what an argument of a move refers to, in which features, and near which joints.

use nalgebra::Vector3;
use poegp_runtime::math::se3::Pose;

use crate::robot_programs::correction::program::{Configuration, Frame, Goal, Target};
use crate::robot_programs::correction::source::Number;
use crate::robot_programs::correction::urscript::states::{Setting, States};
use crate::robot_programs::correction::urscript::{Reader, Variable};
use crate::robot_programs::dialect::Orientation;

impl Reader<'_> {
    /// Returns the arguments of a call that is all tokens from `from` to `end`.
    fn arguments_of(&self, from: usize, end: usize) -> Option<Vec<(usize, usize)>> {
        let text = self.text;
        let is_call = text.is(from + 1, b'(') && text.find(from + 2, end, b")") + 1 == end;
        is_call.then(|| text.arguments(from + 2, end - 1))
    }

    /// Returns the variable that a target is, within its features and kinematics.
    pub(super) fn variable(&self, (from, end): (usize, usize)) -> Option<String> {
        let arguments = self.arguments_of(from, end);
        match (self.text.name(from).as_str(), arguments.as_deref()) {
            ("pose_trans", Some([_, inner])) => self.variable(*inner),
            ("get_inverse_kin", Some([inner, ..])) => self.variable(*inner),
            _ => Some(self.text.spelling(from)).filter(|_| end == from + 1),
        }
    }

    /// Returns the tokens of a value: those of the variable, if it is one that is set once, or the value's own.
    fn tokens_of(&self, from: usize, end: usize) -> (usize, usize) {
        match self.set.get(&self.text.spelling(from)) {
            Some(Variable::Written {
                from: a, end: b, ..
            }) if end == from + 1 => (*a, *b),
            _ => (from, end),
        }
    }

    /// Returns the numbers of `p[x, y, z, rx, ry, rz]`.
    fn numbers(&self, from: usize, end: usize) -> Option<[Number; 6]> {
        let text = self.text;
        if text.name(from) == "p" && text.is(from + 1, b'[') {
            return text.value(from + 1, end).numbers();
        }
        None
    }

    /// Returns a pose that is written directly or in a variable, or the reason why it is not known.
    pub(super) fn pose_of(&self, from: usize, end: usize) -> Result<Pose<f64>, String> {
        let name = self.text.spelling(from);
        if self.reached.contains(&name) && end == from + 1 {
            return Err(format!("{name} is a target of this program"));
        }
        let (from, end) = self.tokens_of(from, end);
        if let Some([outer, inner]) = self.product(from, end) {
            return Ok(self.pose_of(outer.0, outer.1)? * self.pose_of(inner.0, inner.1)?);
        }
        let numbers = self.numbers(from, end);
        let pose = numbers.and_then(|numbers| {
            let n = numbers.map(|n| n.value);
            Some(Pose {
                rotation: Orientation::RotationVector.rotation(&n[3..])?,
                translation: Vector3::new(n[0], n[1], n[2]),
            })
        });
        pose.ok_or_else(|| format!("{name} is computed"))
    }

    /// Returns the two poses of `pose_trans(…, …)`.
    fn product(&self, from: usize, end: usize) -> Option<[(usize, usize); 2]> {
        let is_product = self.text.name(from) == "pose_trans";
        let arguments = self.arguments_of(from, end).filter(|_| is_product)?;
        arguments.try_into().ok()
    }

    /// Returns the pose of a feature as it is at a step.
    fn feature(
        &self,
        (from, end): (usize, usize),
        (states, step): (&States, usize),
    ) -> Result<Pose<f64>, String> {
        if let Some([outer, inner]) = self.product(from, end) {
            let at = (states, step);
            return Ok(self.feature(outer, at)? * self.feature(inner, at)?);
        }
        let name = self.text.spelling(from);
        let key = states.variables.get(&name).filter(|_| end == from + 1);
        let Some(key) = key else {
            return self.pose_of(from, end);
        };
        match states.certain.value(step, *key, &self.program) {
            Ok(Setting::Pose(pose)) => Ok(pose),
            Ok(Setting::Unknown(reason)) => Err(format!("{name}: {reason}")),
            Ok(_) => Err(format!("{name} is not set before it")),
            Err(reason) => Err(format!("{name}: {reason}")),
        }
    }

    /// Returns the target of an argument, and its base frame.
    pub(super) fn target(
        &mut self,
        (from, end): (usize, usize),
        at: (&States, usize),
    ) -> Result<(usize, Frame), String> {
        let text = self.text;
        let base = Frame::own("base", false);
        let arguments = self.arguments_of(from, end);
        match (text.name(from).as_str(), arguments.as_deref()) {
            ("pose_trans", Some(all)) => {
                let [feature, (a, b)] = *all else {
                    return Err("its pose is computed".to_owned());
                };
                let span = text.byte(feature.0)..text.end_of(feature.1 - 1);
                let mut name = text.source.quoted(&span).replace('"', "");
                let pose = self
                    .feature(feature, at)
                    .map_err(|reason| format!("its feature {reason}"))?;
                let (target, inner) = self.target((a, b), at)?;
                if inner.name != base.name {
                    name = format!("{name} · {}", inner.name);
                }
                Ok((
                    target,
                    Frame {
                        name,
                        pose: pose * inner.pose,
                        origin: "the script".to_owned(),
                        ..base
                    },
                ))
            }
            ("get_inverse_kin", Some(all)) => {
                let (a, b) = all.first().copied().ok_or("its pose is computed")?;
                let near = self.near(&all[1..])?;
                let (target, base) = self.target((a, b), at)?;
                if let Some(near) = near {
                    self.put_near(target, near)?;
                }
                Ok((target, base))
            }
            ("" | "p", _) => {
                let target = self.written(from, end).ok_or("a part of it is computed")?;
                self.program.targets.push(target);
                Ok((self.program.targets.len() - 1, base))
            }
            _ => Ok((self.variable_target(from, end)?, base)),
        }
    }

    fn variable_target(&mut self, from: usize, end: usize) -> Result<usize, String> {
        let name = self.text.spelling(from);
        let (a, b, target) = match self.set.get(&name) {
            Some(Variable::Written {
                from: a,
                end: b,
                target,
            }) if end == from + 1 => (*a, *b, *target),
            Some(Variable::Several | Variable::Unknown) if end == from + 1 => {
                return Err(format!(
                    "its target {name} is computed, or set more than once"
                ));
            }
            _ => return Err(format!("its target is computed: {name}")),
        };
        if let Some(index) = target {
            return Ok(index);
        }
        let target = self
            .written(a, b)
            .ok_or_else(|| format!("{name} is computed"))?;
        self.program.targets.push(target);
        let index = self.program.targets.len() - 1;
        if let Some(Variable::Written { target, .. }) = self.set.get_mut(&name) {
            *target = Some(index);
        }
        Ok(index)
    }

    /// Returns the joints near which the inverse kinematics search, from the arguments behind the pose; `None` where they are
    /// those of the arm.
    fn near(&self, arguments: &[(usize, usize)]) -> Result<Option<Vec<f64>>, String> {
        let text = self.text;
        let mut near = None;
        for (index, (from, end)) in arguments.iter().copied().enumerate() {
            let is_named = text.is(from + 1, b'=');
            let (name, from) = match is_named {
                true => (text.name(from), from + 2),
                false => (String::new(), from),
            };
            match (name.as_str(), index) {
                ("qnear", _) | ("", 0) => {
                    if text.name(from) == "get_actual_joint_positions" {
                        continue;
                    }
                    let (a, b) = self.tokens_of(from, end);
                    let numbers = text.value(a, b).numbers::<6>();
                    let numbers = numbers.ok_or("its qnear is computed")?;
                    near = Some(numbers.map(|n| n.value).to_vec());
                }
                ("tcp", _) | ("", 3..) => {
                    return Err("its inverse kinematics have a tool of their own".to_owned());
                }
                _ => {}
            }
        }
        Ok(near)
    }

    /// Notes near which joints a target is.
    fn put_near(&mut self, target: usize, near: Vec<f64>) -> Result<(), String> {
        let stated = &mut self.program.targets[target].configuration;
        match stated.as_ref().and_then(|c| c.near.as_ref()) {
            Some(old) if *old != near => {
                let location = self.program.targets[target].location;
                let reason = "its moves state different joints as qnear";
                self.program.leave(location, reason);
                return Err(reason.to_owned());
            }
            _ => {}
        }
        *stated = Some(Configuration {
            near: Some(near),
            ..Configuration::default()
        });
        Ok(())
    }

    fn written(&self, from: usize, end: usize) -> Option<Target> {
        let goal = match self.numbers(from, end) {
            Some(numbers) => Goal::pose(&numbers),
            None => Goal::Joints(self.text.value(from, end).numbers::<6>()?.to_vec()),
        };
        Some(Target::new(self.location(from), goal, None))
    }
}
