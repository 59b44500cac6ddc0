//! What one step of the chain cannot see is bounded: the search for corrected joints believes it.

use poegp_runtime::chain::{Chain, MinimalForm, MovedFrames};
use poegp_runtime::deflection::{PerJoint, coupled};
use poegp_runtime::newton::{Equations, Place, bent};
use poegp_runtime::poe::no_motions;
use poegp_runtime::se3::Pose;
use proptest::prelude::*;

use crate::seeded::{chains, config, poe};

proptest! {
    #![proptest_config(config(92, 2_000))]

    /// |f(y + s) − f(y) − J s| ≤ ½ |f″[s, s]|, a fifth more for its change on the way; of coupled joints, too, whose columns
    /// may cancel where second derivatives do not.
    #[test]
    fn a_step_goes_no_further_astray_than_its_bound(
        (kinds, frames, q) in chains(),
        weights in prop::collection::vec(-1.0..1.0_f64, 64),
        (is_coupled, opposed) in any::<(bool, bool)>(),
        step in prop::array::uniform8(-0.01..0.01_f64),
        alone in prop::option::of(0..8_usize),
    ) {
        let n = kinds.len();
        let chain = Chain::new(&MinimalForm::new(&poe::<f64>(&kinds, &frames)));
        let mut coupling = [[0.0; 8]; 8];
        for row in 0..n {
            for column in 0..n {
                coupling[row][column] = if row == column {
                    1.0
                } else if opposed {
                    // As the third joint of a parallelogram, which the second one takes back.
                    if row == column + 1 { -1.0 } else { 0.0 }
                } else {
                    weights[8 * row + column]
                };
            }
        }
        let coupling = is_coupled.then_some(&coupling);
        let mut controller: PerJoint<f64> = [0.0; 8];
        controller[..n].copy_from_slice(&q);
        let mut s: PerJoint<f64> = [0.0; 8];
        for joint in 0..n {
            if alone.is_none_or(|only| only % n == joint) {
                s[joint] = step[joint];
            }
        }
        let at = |joints: &PerJoint<f64>, found: &mut MovedFrames<f64>| -> Pose<f64> {
            let mut motions = no_motions();
            chain.motions_into(&coupled(coupling, joints)[..n], &mut motions);
            chain.moved_frames_at(&motions, found)
        };
        let mut found = MovedFrames::new();
        let here = at(&controller, &mut found);
        let mut equations = Equations::new();
        equations.form(
            &Place { kinds: &kinds, frames: &found, point: &here.translation, coupling },
            1.0,
            1e-6,
        );
        let moved = equations.moved(&s);
        let there = at(&core::array::from_fn(|i| controller[i] + s[i]), &mut found);
        let astray: f64 = (0..3)
            .map(|i| there.translation[i] - here.translation[i] - moved[i])
            .map(|d| d * d)
            .sum();
        let astray = libm::sqrt(astray);
        let serial = coupled(coupling, &s);
        let bound = 0.6 * bent(&equations.serial_levers(), &serial, &serial);
        prop_assert!(astray <= bound + 1e-12, "{astray:e} of {bound:e}");
    }
}
