//! Mean errors over cubes of the workspace, and over squares of a view of it: systematic errors add up, noise averages out.

use poegp_calibration::validation::held_out::HeldOutPose;

/// Least number of poses of a cube whose mean is shown.
pub const FEWEST: usize = 3;
/// Least number of poses in the cube of the median pose: smaller cubes would show noise.
const TOGETHER: usize = 6;
/// Sides of cubes, as multiples of a power of ten.
const SIDES: [f64; 9] = [1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 8.0];
/// Least number of cubes along the widest side of the workspace.
const FEWEST_ALONG: f64 = 2.0;
/// Largest number of cubes along the widest side, and below it that of squares of a view.
const MOST_CUBES: f64 = 6.0;
const MOST_SQUARES: f64 = 14.0;

/// Index of a cube in the grid of all cubes.
type Index = [i64; 3];

/// One cube, in mm and in the axes of the base; or a square with the whole depth behind it.
#[derive(Clone, Debug, PartialEq)]
pub struct Cube {
    /// Lower corner; 0 along the viewing direction of a view.
    pub low: [f64; 3],
    /// Indices of the poses in the cube.
    pub members: Vec<usize>,
    /// Mean of the poses' positions.
    pub position: [f64; 3],
}

/// The mean error of a cube by one model.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MeanError {
    /// Mean error along the axes, in mm.
    pub vector: [f64; 3],
    /// Length of the mean error, in mm.
    pub length: f64,
    /// Standard error of the mean, in mm.
    pub standard_error: f64,
}

/// The cubes with [`FEWEST`] poses or more, and their side in mm.
#[derive(Clone, Debug, PartialEq)]
pub struct Cubes {
    /// Side of the cubes, in mm.
    pub side: f64,
    /// Cubes in the order of their first pose.
    pub cubes: Vec<Cube>,
}

impl Cubes {
    /// Divides the positions of the poses into cubes; `widest` is the longest side of the workspace in mm. The side is
    /// the smallest round one with which most poses have neighbours in their cube.
    pub fn new(poses: &[HeldOutPose], widest: f64) -> Self {
        Self::along(&[0, 1, 2], MOST_CUBES, poses, widest)
    }

    /// Divides the positions into squares of the view with these axes, through its whole depth.
    pub fn of_view(axes: [usize; 2], poses: &[HeldOutPose], widest: f64) -> Self {
        Self::along(&axes, MOST_SQUARES, poses, widest)
    }

    fn along(axes: &[usize], most: f64, poses: &[HeldOutPose], widest: f64) -> Self {
        let power = 10f64.powf((widest / most).log10().floor());
        let sides = [1.0, 10.0].map(|decade| SIDES.map(|s| s * decade * power));
        let sides = sides.into_iter().flatten();
        let fits = |side: &f64| (widest / most..=widest / FEWEST_ALONG).contains(side);
        let mut sides: Vec<f64> = sides.filter(fits).collect();
        let largest = sides.pop().unwrap_or(widest);
        let shares = |side: &f64| {
            let cubes = divided(axes, poses, *side);
            let mut together: Vec<usize> = cubes
                .iter()
                .flat_map(|(_, members)| vec![members.len(); members.len()])
                .collect();
            together.sort_unstable();
            together
                .get(together.len() / 2)
                .is_some_and(|n| *n >= TOGETHER)
        };
        let side = sides.into_iter().find(shares).unwrap_or(largest);
        let cube = |(index, members): (Index, Vec<usize>)| {
            let mean = |i: usize| {
                let sum: f64 = members.iter().map(|m| 1e3 * poses[*m].position[i]).sum();
                sum / members.len() as f64
            };
            Cube {
                low: index.map(|x| x as f64 * side),
                position: [0, 1, 2].map(mean),
                members,
            }
        };
        let filled = divided(axes, poses, side)
            .into_iter()
            .filter(|(_, members)| members.len() >= FEWEST);
        Self {
            side,
            cubes: filled.map(cube).collect(),
        }
    }

    /// Returns the indices of the cubes by their mean errors of `poses`, the largest first.
    pub fn by_error(&self, poses: &[HeldOutPose]) -> Vec<usize> {
        let lengths: Vec<f64> = self
            .cubes
            .iter()
            .map(|c| c.mean_error(poses).length)
            .collect();
        let mut order: Vec<usize> = (0..self.cubes.len()).collect();
        order.sort_by(|a, b| lengths[*b].total_cmp(&lengths[*a]).then(a.cmp(b)));
        order
    }
}

/// Groups the poses by the cube that contains them.
fn divided(axes: &[usize], poses: &[HeldOutPose], side: f64) -> Vec<(Index, Vec<usize>)> {
    let mut out: Vec<(Index, Vec<usize>)> = Vec::new();
    let mut known = std::collections::HashMap::new();
    for (i, pose) in poses.iter().enumerate() {
        let mut index = Index::default();
        for axis in axes {
            index[*axis] = (1e3 * pose.position[*axis] / side).floor() as i64;
        }
        let at = *known.entry(index).or_insert(out.len());
        if at == out.len() {
            out.push((index, Vec::new()));
        }
        out[at].1.push(i);
    }
    out
}

impl Cube {
    /// Returns the mean error of a model in this cube.
    pub fn mean_error(&self, poses: &[HeldOutPose]) -> MeanError {
        let n = self.members.len() as f64;
        let values = |i: usize| {
            self.members
                .iter()
                .map(move |m| 1e3 * poses[*m].residual[i])
        };
        let vector = [0, 1, 2].map(|i| values(i).sum::<f64>() / n);
        let scatter: f64 = (0..3)
            .map(|i| values(i).map(|x| (x - vector[i]).powi(2)).sum::<f64>())
            .sum();
        MeanError {
            vector,
            length: vector.iter().map(|x| x * x).sum::<f64>().sqrt(),
            standard_error: (scatter / (n - 1.0).max(1.0) / n).sqrt(),
        }
    }
}

impl MeanError {
    /// Returns the axis along which the error points most, with its sign.
    pub fn direction(&self) -> String {
        let size = |i: &usize| self.vector[*i].abs();
        let axis = (0..3)
            .max_by(|a, b| size(a).total_cmp(&size(b)))
            .unwrap_or(0);
        let sign = if self.vector[axis] < 0.0 { '−' } else { '+' };
        format!("{sign}{}", ['x', 'y', 'z'][axis])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use poegp_calibration::numeric::statistics::PoseError;

    fn pose(position: [f64; 3], residual: [f64; 3]) -> HeldOutPose {
        let [x, y, z] = residual;
        HeldOutPose {
            error: PoseError {
                position_mm: 1e3 * (x * x + y * y + z * z).sqrt(),
                orientation_mrad: None,
            },
            position,
            residual: [x, y, z, 0.0, 0.0, 0.0],
            sigma: None,
            noise: Default::default(),
        }
    }

    /// A regular grid of 9³ poses within 0.9 m: errors that are alike stay, those that cancel vanish, whatever the cubes.
    #[test]
    fn what_is_alike_stays_and_what_cancels_vanishes() {
        let step = |i: usize| 0.05 + 0.1 * i as f64;
        let all = (0..729).map(|i| {
            let [x, y, z] = [i / 81, i / 9 % 9, i % 9].map(step);
            let noise = if i % 2 == 0 { 1e-3 } else { -1e-3 };
            pose(
                [x, y - 0.45, z],
                [noise, 0.0, if x > 0.6 { -2e-3 } else { 0.0 }],
            )
        });
        let poses: Vec<HeldOutPose> = all.collect();
        let cubes = Cubes::new(&poses, 900.0);
        assert_eq!(cubes.side, 200.0);
        let of = |cube: &Cube| -> usize { cube.members.len() };
        assert!(cubes.cubes.iter().map(of).sum::<usize>() >= 700);
        for cube in &cubes.cubes {
            for member in &cube.members {
                for i in 0..3 {
                    let within = 1e3 * poses[*member].position[i] - cube.low[i];
                    assert!((0.0..=cubes.side).contains(&within), "{cube:?}");
                }
            }
            let found = cube.mean_error(&poses);
            let n = of(cube) as f64;
            assert!(found.vector[0].abs() <= 1.0 / n + 1e-12);
            // Independently: the variance of ±1 is 1, and that of the mean smaller by n.
            assert!(
                found.standard_error <= 1.0 / (n - 1.0).sqrt() * 1.5,
                "{found:?}"
            );
        }
        let worst = &cubes.cubes[cubes.by_error(&poses)[0]];
        let found = worst.mean_error(&poses);
        assert!((found.vector[2] + 2.0).abs() < 1e-9, "{found:?}");
        assert_eq!(found.direction(), "−z");
        assert!(worst.low[0] >= 600.0);
    }

    /// Squares of a view have more poses than cubes of the same side, and are smaller for it.
    #[test]
    fn a_view_is_averaged_through_its_depth() {
        let all = (0..512).map(|i| {
            let [x, y, z] = [i / 64, i / 8 % 8, i % 8].map(|k| 0.05 + 0.1 * f64::from(k));
            pose([x, y, z], [1e-3 * x, 0.0, 1e-3 * z])
        });
        let poses: Vec<HeldOutPose> = all.collect();
        let (view, cubes) = (
            Cubes::of_view([0, 1], &poses, 800.0),
            Cubes::new(&poses, 800.0),
        );
        assert_eq!((view.side, cubes.side), (60.0, 200.0));
        assert_eq!(view.cubes.len(), 64);
        for square in &view.cubes {
            let found = square.mean_error(&poses);
            assert_eq!(square.members.len(), 8);
            assert!((found.vector[0] - 1e-3 * square.position[0]).abs() < 1e-9);
            assert!((found.vector[2] - 0.4).abs() < 1e-9, "{found:?}");
        }
    }

    #[test]
    fn few_poses_have_large_cubes_or_none() {
        let few: Vec<HeldOutPose> = (0..4)
            .map(|i| pose([0.3 * f64::from(i), 0.0, 0.0], [1e-4, 0.0, 0.0]))
            .collect();
        assert!(
            Cubes::new(&few, 900.0)
                .cubes
                .iter()
                .all(|c| c.members.len() >= FEWEST)
        );
        assert!(Cubes::new(&[], 900.0).cubes.is_empty());
    }
}
