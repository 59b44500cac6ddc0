//! The cost of a model on the device: a bound on the instructions of a cycle, from the sizes of the model.
//!
//! No loop of an evaluation ends early, so its instructions depend on the model and hardly on the query. They are a sum of
//! terms: so many instructions for each joint, each inducing point, each word of a point. `POSE` and `COMMAND` hold the
//! instructions of each term.

use poegp_protocol::limits::MAX_JOINTS;

use crate::gp::joint_processes::JointProcesses;
use crate::gp::quadratic_variance::BLOCK;
use crate::math::scalar::Scalar;

/// The sizes of a model.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ModelSize {
    /// Number of joints of the arm.
    pub joints: usize,
    /// Number of prismatic joints.
    pub sliding: usize,
    /// Number of nonzero elements of C − I, where C is the joint coupling.
    pub coupling_terms: usize,
    /// Number of serial joints with a nonzero element of C − I.
    pub coupled_joints: usize,
    /// Sizes of the correction.
    pub correction: CorrectionSize,
}

/// The sizes of a correction.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CorrectionSize {
    /// No correction.
    None,
    /// The paper's correction in task space.
    TaskSpace {
        /// Number of inputs: the joints, and the payload if it is an input.
        inputs: usize,
        /// Number of inducing points.
        points: usize,
        /// Form of the rows of inducing points.
        form: TaskSpaceForm,
        /// Number of landmarks of the standard deviation; 0 for none.
        landmarks: usize,
    },
    /// The elastic correction, in joint space.
    Elastic(ElasticSize),
}

/// How the rows of a correction in task space are stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TaskSpaceForm {
    /// Folded about the middle of the inducing points.
    Folded,
    /// Difference form, with one exponential for all outputs.
    Differences,
    /// Difference form, with an exponential for each output or a number of inputs for which there is no unrolled loop.
    PerOutput,
}

/// The sizes of the Gaussian processes that one kind of loops evaluates.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ProcessesSize {
    /// Number of joints with such a process.
    pub sets: usize,
    /// Number of joints on which a process depends, summed over the processes.
    pub looked_at: usize,
    /// Number of inducing points of all processes.
    pub points: usize,
    /// Number of words of all rows of inducing points.
    pub words: usize,
    /// Number of payload groups with inducing points, summed over the processes.
    pub blocks: usize,
}

impl ProcessesSize {
    /// Returns the sizes of the `processes` that the unrolled loops evaluate, or of those that the general loops evaluate.
    #[inline(never)]
    fn of<T: Scalar>(processes: &JointProcesses<T>, unrolled: bool) -> Self {
        let mut out = Self::default();
        for set in &processes.sets {
            if processes.is_unrolled_for(set) != unrolled {
                continue;
            }
            out.sets += 1;
            out.looked_at += set.joints().len();
            out.words += set.words();
            for points in set.points() {
                out.points += usize::from(*points);
                out.blocks += usize::from(*points > 0);
            }
        }
        out
    }
}

/// The sizes of an elastic correction.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ElasticSize {
    /// Number of revolute joints on which gravity acts.
    pub loaded_joints: usize,
    /// Number of links between each loaded joint and the last joint, summed over the loaded joints.
    pub loaded_links: usize,
    /// Whether gravity is parallel to the z axis of the base.
    pub upright: bool,
    /// Sizes of the processes that the unrolled loops evaluate.
    pub unrolled: ProcessesSize,
    /// Sizes of the processes that the general loops evaluate.
    pub general: ProcessesSize,
    /// Number of prismatic joints that are centred for the unrolled loops.
    pub centred: usize,
    /// Number of payload groups.
    pub groups: usize,
    /// Number of terms of gear ripple.
    pub ripple: usize,
    /// Number of orders of each joint's own-joint curve; 0 for none.
    pub curve_orders: usize,
    /// Number of landmarks of the standard deviation; 0 for none.
    pub landmarks: usize,
}

impl ElasticSize {
    /// Returns these sizes with those of `processes` filled in.
    pub fn with_processes<T: Scalar>(self, processes: &JointProcesses<T>) -> Self {
        Self {
            unrolled: ProcessesSize::of(processes, true),
            general: ProcessesSize::of(processes, false),
            centred: processes.centred_joints(),
            groups: processes.group_payloads_kg.len(),
            ..self
        }
    }

    /// Returns the number of inducing points of all processes.
    pub fn points(&self) -> usize {
        self.unrolled.points + self.general.points
    }

    /// Returns the number of words of all rows of inducing points.
    pub fn words(&self) -> usize {
        self.unrolled.words + self.general.words
    }
}

/// Number of terms of the sum: those of every arm, of the three forms of a correction in task space, of its standard
/// deviation, and of an elastic correction.
pub const TERMS: usize = OF_ARM + 3 * OF_TASK_SPACE + OF_VARIANCE + OF_ELASTIC;
const OF_ARM: usize = 7;
const OF_TASK_SPACE: usize = 4;
const OF_VARIANCE: usize = 5;
const OF_ELASTIC: usize = 32;

impl ModelSize {
    /// Returns how often each term counts in the sum.
    pub fn counts(&self) -> [usize; TERMS] {
        let mut out = [0; TERMS];
        let (arm, corrections) = out.split_at_mut(OF_ARM);
        let is_coupled = usize::from(self.coupling_terms > 0);
        let is_long = usize::from(self.joints > 6);
        let turns_every_way = usize::from(self.joints >= 6);
        copy(
            arm,
            &[
                1,
                self.joints,
                turns_every_way,
                is_long,
                self.sliding,
                is_coupled,
                self.coupling_terms,
            ],
        );
        let (task_space, corrections) = corrections.split_at_mut(3 * OF_TASK_SPACE);
        let (variance, elastic_terms) = corrections.split_at_mut(OF_VARIANCE);
        match self.correction {
            CorrectionSize::None => {}
            CorrectionSize::TaskSpace {
                inputs,
                points,
                form,
                landmarks: l,
            } => {
                let (varies, blocks) = (usize::from(l > 0), l.div_ceil(BLOCK));
                let is_long = usize::from(inputs > 7);
                let pairs = blocks * (blocks + 1) / 2;
                copy(variance, &[varies, l, l * is_long, blocks, pairs]);
                let mut forms = task_space.chunks_mut(OF_TASK_SPACE);
                if let Some(terms) = forms.nth(form as usize) {
                    copy(terms, &[1, inputs, points, points * inputs]);
                }
            }
            CorrectionSize::Elastic(elastic) => {
                copy(elastic_terms, &elastic.counts(self));
            }
        }
        out
    }
}

fn copy(to: &mut [usize], from: &[usize]) {
    for (slot, value) in to.iter_mut().zip(from) {
        *slot = *value;
    }
}

/// Number of orders of a curve in a step of the loops in assembly; the remaining orders are computed one by one.
const ORDERS_OF_A_STEP: usize = 8;
/// Number of orders in a step if the loops compute the curve's derivative, too.
const ORDERS_AND_SLOPES_OF_A_STEP: usize = 4;

impl ElasticSize {
    fn counts(&self, arm: &ModelSize) -> [usize; OF_ELASTIC] {
        let (n, sliding) = (arm.joints, arm.sliding);
        let (joints, links) = (self.loaded_joints, self.loaded_links);
        let (upright, tilted) = (usize::from(self.upright), usize::from(!self.upright));
        let (fast, slow) = (&self.unrolled, &self.general);
        let sets = fast.sets + slow.sets;
        let curves = if self.curve_orders > 0 {
            n - sliding.min(n)
        } else {
            0
        };
        let l = self.landmarks;
        let varies = usize::from(l > 0);
        [
            1,
            n,
            sliding,
            arm.coupled_joints,
            upright * joints,
            upright * links,
            tilted * joints,
            tilted * links,
            usize::from(sets > 0),
            fast.sets,
            fast.looked_at,
            fast.sets * self.groups,
            fast.blocks,
            fast.points,
            fast.words,
            sets * self.centred,
            usize::from(self.centred > 0),
            slow.sets,
            slow.sets * self.groups,
            slow.points,
            slow.words,
            self.ripple,
            usize::from(self.curve_orders > 0),
            curves,
            curves * self.curve_orders,
            curves * (self.curve_orders % ORDERS_OF_A_STEP),
            curves * (self.curve_orders % ORDERS_AND_SLOPES_OF_A_STEP),
            varies,
            varies * n,
            l,
            l * n,
            l * l,
        ]
    }
}

// `tests/peers/run cost` finds these numbers by linear programming from 1 600 models of all shapes on the emulated device:
// the bound is never too low and as tight as possible. `tests/tests/device/cost_bound.rs` compares it with sixty other
// models in every run.

/// Instructions of each term of one evaluation, in 256ths.
#[rustfmt::skip] // arm; folded, differences, per output; variance; elastic
const POSE: [i32; TERMS] = [
    116359, 44169, 0, -4431, -10951, 15273, 3531,
    126071, 13020, 7261, 552,
    215243, 8516, 10734, 1047,
    161893, 17967, 40054, 2317,
    119310, 15935, 11177, 13570, 15378,
    191678, 44482, 299, 20945, 20084, 2894, 24705, 4981, 1891, 38651, 3118, 1657, 12218, 3683, 576, 507, 78961, 21194, 14012, 10448, 2917, 19603, 19828, 5534, 1645, 2642, -97, 88240, 23796, 22341, 4053, 1194,
];
/// Instructions of each term of one command, with the filter and without the frames on the link, in 256ths.
#[rustfmt::skip] // the same
const COMMAND: [i32; TERMS] = [
    1027583, 149664, 143687, 35884, -23690, 58900, 29028,
    551443, 57016, 21134, 1751,
    845578, 37281, 32056, 3169,
    656815, 71500, 119954, 7009,
    -1029, 10672, 976, -38600, -447,
    394707, 47561, 22047, 18053, 48570, 7043, 58701, 9515, 7817, 33020, 3765, 2116, 11868, 3812, 547, 1576, 81196, 31994, 12064, 9821, 3039, 21037, 30195, 20658, 3793, 90, 4089, -37765, 5333, 4657, -638, -25,
];

/// Instructions for reading a command's frame and writing the answer's, for an arm with one joint, two, …: counted with
/// three zeros in each number, which takes longest, plus 200 for a timer interrupt in between. Bytes come in pieces, so the
/// instructions do not grow linearly with the joints.
const FRAME: [u32; MAX_JOINTS] = [4_050, 4_640, 5_010, 5_700, 6_290, 6_930, 7_450, 8_100];
/// Instructions for the frames of an evaluation, whose answer is longer and has no joints.
const EVALUATION_FRAME: u32 = 4_900;
/// Instructions for the frames of an evaluation that each joint adds.
const EVALUATION_FRAME_JOINT: u32 = 320;

impl ModelSize {
    /// Returns a bound on the instructions of one evaluation on a Cortex-M4F.
    pub fn pose_bound(&self) -> u32 {
        bound(&self.counts(), &POSE)
    }

    /// Returns a bound on the instructions of one command on a Cortex-M4F, from the last byte of its frame to the first of
    /// the answer's: frame, correction and filter. It also bounds an evaluation and a correction with their frames: with
    /// few inducing points the standard deviation may take longer than a correction.
    pub fn command_bound(&self) -> u32 {
        let joints = self.joints as u32;
        let frame = FRAME.get(self.joints.saturating_sub(1)).copied();
        let command = self.computation_bound() + frame.unwrap_or(FRAME[MAX_JOINTS - 1]);
        let evaluation = self.pose_bound() + EVALUATION_FRAME + EVALUATION_FRAME_JOINT * joints;
        command.max(evaluation)
    }

    /// Returns a bound on the instructions of one command without its frames: correction and filter.
    pub fn computation_bound(&self) -> u32 {
        bound(&self.counts(), &COMMAND)
    }
}

fn bound(counts: &[usize; TERMS], each: &[i32; TERMS]) -> u32 {
    let mut sum = 0_i32;
    for (count, each) in counts.iter().zip(each) {
        sum = sum.saturating_add((*count as i32).saturating_mul(*each));
    }
    (sum / 256).max(0) as u32
}
