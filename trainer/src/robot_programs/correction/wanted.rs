//! What a target states of its branch: ranges of its joints, and the sides of wrist, elbow and shoulder.

use poegp_calibration::blob::commander::{Commander, Joints};

use crate::robot_programs::correction::posture::{Arm, Sides, sides};
use crate::robot_programs::correction::program::{
    Bound, Configuration, NOISE, SLACK, Says, Stated,
};

/// What the letters of configurations are, as far as poses have shown it: for wrist, elbow and shoulder a letter and its side.
pub type Meaning = [Option<(bool, bool)>; 3];

/// Returns whether a letter has no meaning yet.
pub fn has_new_letter(letters: &[Option<bool>; 3], meaning: &Meaning) -> bool {
    let mut all = letters.iter().zip(meaning);
    all.any(|(letter, meaning)| letter.is_some() && meaning.is_none())
}

/// Returns the sides that a configuration states by letters whose meaning is known.
fn sides_of_letters(configuration: &Configuration, meaning: &Meaning) -> Sides {
    let mut out = Sides::default();
    for (slot, (letter, meaning)) in out
        .iter_mut()
        .zip(configuration.letters.iter().zip(meaning))
    {
        *slot = letter
            .zip(*meaning)
            .map(|(letter, (known, side))| (letter == known) == side);
    }
    out
}

/// Returns whether joints are on these sides. `None` is either side.
pub fn is_on(commander: &Commander, joints: &Joints, wanted: &Sides) -> bool {
    if wanted.iter().all(Option::is_none) {
        return true;
    }
    let mut all = sides(commander, joints).into_iter().zip(wanted);
    all.all(|(side, wanted)| side.zip(*wanted).is_none_or(|(a, b)| a == b))
}

/// What a target states of its branch.
pub struct Wanted<'a> {
    commander: &'a Commander,
    configuration: &'a Configuration,
    /// Sides without which the controller does not go to the target.
    must: Sides,
    /// All sides that are stated, also those that a controller takes only where the path does not decide.
    pub should: Sides,
}

impl<'a> Wanted<'a> {
    /// Returns what a configuration states, as far as its letters have a meaning.
    pub fn new(
        commander: &'a Commander,
        arm: &Arm,
        configuration: &'a Configuration,
        meaning: &Meaning,
    ) -> Self {
        let mut must = sides_of_letters(configuration, meaning);
        let mut should = must;
        if let Some(posture) = &configuration.posture {
            let stated = arm.stated(posture);
            let add = |to: &mut Sides| {
                for (slot, side) in to.iter_mut().zip(stated) {
                    *slot = slot.or(side);
                }
            };
            add(&mut should);
            if posture.is_certain && configuration.is_monitored {
                add(&mut must);
            }
        }
        Self {
            commander,
            configuration,
            must,
            should,
        }
    }

    /// Returns the slack that is tried first. Where a controller monitors turns, a joint on the other side of a boundary
    /// counts only if no solution is on this one.
    pub fn least(&self) -> f64 {
        let is_quarter = |stated: &Stated| matches!(stated.says, Says::Quarter(_));
        let is_loose =
            !self.configuration.is_monitored || self.configuration.stated.iter().any(is_quarter);
        if is_loose { SLACK } else { NOISE }
    }

    /// Returns whether joints have the configuration.
    pub fn fits(&self, joints: &Joints, slack: f64) -> bool {
        let less = SLACK - slack;
        let within = |(joint, lower, upper): &Bound| {
            let range = lower + less..=upper - less;
            joints.get(*joint).is_some_and(|q| range.contains(q))
        };
        self.configuration.bounds.iter().all(within) && is_on(self.commander, joints, &self.must)
    }

    /// Returns the branches that have the configuration, as far as any has it.
    pub fn fitting<'b>(&self, branches: &'b [Joints]) -> Vec<&'b Joints> {
        let of = |slack: f64| -> Vec<&Joints> {
            let fits = |joints: &&Joints| self.fits(joints, slack);
            branches.iter().filter(fits).collect()
        };
        let all = match of(self.least()) {
            none if none.is_empty() => of(SLACK),
            some => some,
        };
        let is_preferred = |joints: &&Joints| is_on(self.commander, joints, &self.should);
        let preferred: Vec<&Joints> = all.iter().copied().filter(is_preferred).collect();
        match preferred.is_empty() {
            true => all,
            false => preferred,
        }
    }

    /// Returns whether the target leaves a side of the arm open, so that a controller with a configuration has to take it from
    /// elsewhere.
    pub fn is_open(&self, joints: &Joints) -> bool {
        let mut all = self.should.iter().zip(sides(self.commander, joints));
        self.configuration.is_monitored
            && all.any(|(stated, side)| stated.is_none() && side.is_some())
    }

    /// Returns those of the fitting branches that are on other sides than `joints`.
    pub fn rivals(&self, fitting: &[&Joints], joints: &Joints) -> Vec<Joints> {
        let own = sides(self.commander, joints);
        let others = fitting.iter().copied().copied();
        others
            .filter(|other| !is_on(self.commander, other, &own))
            .collect()
    }
}
