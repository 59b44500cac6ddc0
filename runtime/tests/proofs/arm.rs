//! An arm whose numbers a test can change one by one: a blob that owns its data.

use poegp_protocol::JointKind;
use poegp_protocol::blob::{
    Blob, Correction, CorrectionLimit, Elastic, Geometry, Joint, JointKernel, Ranges, Ripple,
    Robot, TaskSpace, Units,
};
use poegp_protocol::cause::Causes;
use poegp_protocol::limits::{MAX_JOINTS, OUTPUTS};
use poegp_runtime::math::scalar::Scalar;
use poegp_runtime::math::se3::{Pose, Twist};
use poegp_runtime::model::Model;
use poegp_runtime::trace::Observer;

/// Capacity for the inducing points of every arm here.
pub const WORDS: usize = 1_024;

/// An arm. `blob` borrows from it.
#[derive(Clone, Debug)]
pub struct Arm {
    pub joints: Vec<Joint>,
    pub coupling: Vec<f32>,
    pub ranges: Vec<(f32, f32)>,
    pub payload: Option<(f32, f32)>,
    pub calibrated: Vec<[f32; 12]>,
    pub nominal: Vec<[f32; 12]>,
    pub task: Option<Task>,
    pub elastic: Option<Elastic<'static>>,
    /// Rows of inducing points of the elastic correction.
    pub rows: Vec<f32>,
    /// Own-joint curves of the elastic correction.
    pub curves: Vec<f32>,
    bytes: Vec<u8>,
    curve_bytes: Vec<u8>,
}

/// Orders of the own-joint curves of an elastic [`Arm`].
pub const CURVE_ORDERS: usize = 2;

/// The correction of an [`Arm`].
#[derive(Clone, Debug)]
pub struct Task {
    pub limit: CorrectionLimit,
    pub input_scale: Vec<f32>,
    pub centre: Vec<f32>,
    pub rates: Option<[f32; OUTPUTS]>,
    pub affine: [Vec<f32>; OUTPUTS],
    pub rows: Vec<f32>,
}

/// Returns numbers in [−1, 1] that look random but are the same in every run.
pub fn scattered(seed: u32) -> impl FnMut() -> f32 {
    let mut state = seed;
    move || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 8) as f32 / 8_388_608.0 - 1.0
    }
}

impl Arm {
    /// Returns a valid arm of `joints` joints, every third prismatic, with `points` inducing points and a payload.
    pub fn sound(joints: usize, points: usize) -> Self {
        let mut next = scattered(joints as u32 * 1_000 + points as u32);
        let mut frame = || {
            let twist: [f32; 6] = core::array::from_fn(|index| next() * [0.5, 3.0][index / 3]);
            Pose::exp(&Twist::from_array(&twist)).to_rows()
        };
        let calibrated: Vec<[f32; 12]> = (0..=joints).map(|_| frame()).collect();
        let nominal = calibrated.clone();
        let mut next = scattered(points as u32);
        let inputs = joints + 1;
        let mut rows = Vec::new();
        for _ in 0..points {
            rows.extend((0..inputs).map(|_| next()));
            rows.extend((0..OUTPUTS).map(|c| next() * [1e-3, 1e-4][c / 3]));
        }
        let kind = |index: usize| match index % 3 {
            2 => JointKind::Prismatic,
            _ => JointKind::Revolute,
        };
        let joint = |index| Joint {
            kind: kind(index),
            limits: Some((-3.0, 3.0)),
        };
        Self {
            joints: (0..joints).map(joint).collect(),
            coupling: Vec::new(),
            ranges: vec![(-2.0, 2.0); joints],
            payload: Some((0.0, 10.0)),
            calibrated,
            nominal,
            task: Some(Task {
                limit: CorrectionLimit {
                    position_m: 0.1,
                    angle_rad: 0.01,
                },
                input_scale: vec![0.5; inputs],
                rates: None,
                centre: Vec::new(),
                affine: core::array::from_fn(|c| {
                    (0..=inputs).map(|_| next() * [1e-4, 1e-5][c / 3]).collect()
                }),
                rows,
            }),
            elastic: None,
            rows: Vec::new(),
            curves: Vec::new(),
            bytes: Vec::new(),
            curve_bytes: Vec::new(),
        }
    }

    /// Returns an arm with an elastic correction. Each joint has about `points` inducing points in two payload groups. The
    /// kernels depend on one joint, two joints, … up to all of them. There are two ripple terms and own-joint curves. Every
    /// third joint is prismatic if `sliding`.
    pub fn elastic(joints: usize, points: usize, sliding: bool) -> Self {
        let mut arm = Self::sound(joints, 0);
        arm.task = None;
        if !sliding {
            for joint in &mut arm.joints {
                joint.kind = JointKind::Revolute;
            }
        }
        let mut next = scattered(77 + 10 * joints as u32 + points as u32);
        let mut positive = |size: f32| size * (0.55 + 0.45 * next());
        let mut kernels: heapless::Vec<JointKernel, MAX_JOINTS> = (0..joints)
            .map(|_| JointKernel {
                rates: (0..joints).map(|_| positive(2.0)).collect(),
                payload_rate: positive(0.05),
                amplitude: positive(1.0),
                payload_amplitude: positive(0.01),
            })
            .collect();
        let mut small = |size: f32| size * next();
        let each = points.div_ceil(joints);
        for (c, kernel) in kernels.iter_mut().enumerate() {
            for (joint, rate) in kernel.rates.iter_mut().enumerate() {
                // The kernel of joint c depends on joint c and some of those that follow.
                if (joint + joints - c) % joints > c {
                    *rate = 0.0;
                }
            }
            for _ in 0..each {
                for (joint, rate) in arm.joints.iter().zip(&kernel.rates) {
                    let q = small(3.0);
                    if *rate > 0.0 {
                        arm.rows.extend(match joint.kind {
                            JointKind::Revolute => [libm::sinf(q), libm::cosf(q)],
                            JointKind::Prismatic => [q, 0.0],
                        });
                    }
                }
                arm.rows.push(small(1e-4));
            }
        }
        let half = each / 2;
        arm.elastic = Some(Elastic {
            limit: CorrectionLimit {
                position_m: 0.1,
                angle_rad: 0.1,
            },
            gravity: [0.3, -0.5, -9.7],
            links: (0..joints * (joints + 1) / 2)
                .map(|_| core::array::from_fn(|_| small(1e-5)))
                .collect(),
            payload: (0..joints)
                .map(|_| core::array::from_fn(|_| small(1e-6)))
                .collect(),
            ripple: (0..2)
                .map(|term| Ripple {
                    joint: (term % joints) as u8,
                    cycles: 60.0 + small(10.0),
                    sin: small(1e-5),
                    cos: small(1e-5),
                })
                .collect(),
            kernels,
            group_payloads_kg: [1.0, 8.0].into_iter().collect(),
            sets: (0..joints)
                .map(|_| [half as u16, (each - half) as u16].into_iter().collect())
                .collect(),
            rows: &[],
            curves: &[],
        });
        for joint in &arm.joints {
            let size = match joint.kind {
                JointKind::Revolute => 1e-5,
                JointKind::Prismatic => 0.0,
            };
            arm.curves
                .extend((0..2 * CURVE_ORDERS).map(|_| small(size)));
        }
        arm
    }

    /// Returns the elastic correction, for changes.
    pub fn joint_space(&mut self) -> &mut Elastic<'static> {
        self.elastic.as_mut().expect("an elastic correction")
    }

    /// Returns the task-space correction, for changes.
    pub fn task(&mut self) -> &mut Task {
        self.task.as_mut().expect("a correction")
    }

    /// Returns every number that the runtime uses.
    pub fn numbers(&mut self) -> Vec<&mut f32> {
        let mut out: Vec<&mut f32> = Vec::new();
        let limits = self.joints.iter_mut().filter_map(|j| j.limits.as_mut());
        let pairs = limits.chain(&mut self.ranges).chain(&mut self.payload);
        out.extend(pairs.flat_map(|(lower, upper)| [lower, upper]));
        out.extend(self.coupling.iter_mut());
        out.extend(self.calibrated.iter_mut().flatten());
        out.extend(self.nominal.iter_mut().flatten());
        if let Some(task) = &mut self.task {
            out.extend([&mut task.limit.position_m, &mut task.limit.angle_rad]);
            out.extend(&mut task.input_scale);
            out.extend(task.rates.iter_mut().flatten());
            out.extend(task.affine.iter_mut().flatten());
            out.extend(&mut task.rows);
            out.extend(&mut task.centre);
        }
        if let Some(elastic) = &mut self.elastic {
            out.extend([&mut elastic.limit.position_m, &mut elastic.limit.angle_rad]);
            out.extend(&mut elastic.gravity);
            out.extend(elastic.links.iter_mut().flatten());
            out.extend(elastic.payload.iter_mut().flatten());
            for term in &mut elastic.ripple {
                out.extend([&mut term.cycles, &mut term.sin, &mut term.cos]);
            }
            for kernel in &mut elastic.kernels {
                out.extend(&mut kernel.rates);
                out.extend([
                    &mut kernel.payload_rate,
                    &mut kernel.amplitude,
                    &mut kernel.payload_amplitude,
                ]);
            }
            out.extend(&mut elastic.group_payloads_kg);
            out.extend(&mut self.rows);
            out.extend(&mut self.curves);
        }
        out
    }

    /// Returns the blob of this arm.
    pub fn blob(&mut self) -> Blob<'_> {
        let rows = self.task.iter().flat_map(|task| &task.rows);
        let rows = rows.chain(&self.rows);
        self.bytes = rows.flat_map(|word| word.to_le_bytes()).collect();
        let curves = self.curves.iter();
        self.curve_bytes = curves.flat_map(|word| word.to_le_bytes()).collect();
        self.blob_with(&self.bytes)
    }

    /// Returns the blob of this arm with these bytes as inducing points.
    pub fn blob_with<'a>(&'a self, rows: &'a [u8]) -> Blob<'a> {
        Blob {
            robot: Robot {
                name: "arm",
                serial_number: "",
                joints: self.joints.iter().copied().collect(),
                coupling: self.coupling.iter().copied().collect(),
            },
            units: Units::SI,
            ranges: Ranges {
                joints: self.ranges.iter().copied().collect(),
                payload_kg: self.payload,
            },
            geometry: Geometry {
                calibrated: self.calibrated.iter().copied().collect(),
                nominal: self.nominal.iter().copied().collect(),
            },
            correction: if let Some(elastic) = &self.elastic {
                Correction::Elastic(Elastic {
                    rows,
                    curves: &self.curve_bytes,
                    ..elastic.clone()
                })
            } else {
                self.task.as_ref().map_or(Correction::None, |task| {
                    Correction::TaskSpace(TaskSpace {
                        limit: task.limit,
                        hyperparameters: heapless::Vec::new(),
                        output_scale: [1.0; OUTPUTS],
                        input_scale: task.input_scale.iter().copied().collect(),
                        rates: task.rates,
                        centre: task.centre.iter().copied().collect(),
                        affine: core::array::from_fn(|c| task.affine[c].iter().copied().collect()),
                        rows,
                        landmarks: 0,
                        landmark_rows: &[],
                    })
                })
            },
            warnings: Causes::NONE,
            host: &[],
            variance: None,
        }
    }

    /// Returns the model of this arm.
    pub fn model<T: Scalar>(&mut self) -> Model<T, WORDS> {
        let mut model = Model::new();
        model.load_decoded(&self.blob()).expect("a sound arm");
        model
    }
}

/// All numbers of one evaluation, in order.
#[derive(Debug, Default)]
pub struct Seen {
    pub motions: Vec<f64>,
    pub chain: Vec<f64>,
    pub mean: Vec<f64>,
    pub deflection: Vec<f64>,
}

impl Seen {
    /// Returns whether no number is NaN or infinite.
    pub fn is_finite(&self) -> bool {
        let all = [&self.motions, &self.chain, &self.mean, &self.deflection];
        all.into_iter().flatten().all(|value| value.is_finite())
    }
}

impl<T: Scalar> Observer<T> for Seen {
    fn motions(&mut self, motions: &[[T; 2]]) {
        let numbers = motions.iter().flatten().copied();
        self.motions.extend(numbers.map(T::to_f64));
    }
    fn chain(&mut self, pose: &Pose<T>) {
        self.chain.extend(pose.to_rows().map(T::to_f64));
    }
    fn mean(&mut self, mean: &[T; OUTPUTS]) {
        self.mean.extend(mean.map(T::to_f64));
    }
    fn deflection(&mut self, deflection: &[T; MAX_JOINTS]) {
        self.deflection.extend(deflection.map(T::to_f64));
    }
}
