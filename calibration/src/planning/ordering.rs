//! The order of a plan: payload by payload, and with each payload a short path through the joints.
//!
//! Joints move at the same time, so a move takes as long as its slowest joint. The distance from one pose to the next is the
//! largest joint move, as a share of that joint's planned range. The path starts with nearest neighbours; then 2-opt
//! reverses parts of it until no reversal shortens it. It begins where the one before ended and does not return.

/// Returns the largest joint move, as a share of the joint's range.
fn distance(a: &[f64], b: &[f64], ranges: &[(f64, f64)]) -> f64 {
    a.iter()
        .zip(b)
        .zip(ranges)
        .map(|((x, y), (lower, upper))| (x - y).abs() / (upper - lower))
        .fold(0.0, f64::max)
}

/// Returns the length of a path.
pub fn length<'a>(poses: impl IntoIterator<Item = &'a Vec<f64>>, ranges: &[(f64, f64)]) -> f64 {
    let mut poses = poses.into_iter();
    let Some(mut last) = poses.next() else {
        return 0.0;
    };
    let mut sum = 0.0;
    for pose in poses {
        sum += distance(last, pose, ranges);
        last = pose;
    }
    sum
}

/// Returns an order of `poses`, by index; the path begins at `start`, or anywhere for `None`.
pub fn shortest_path_order(
    poses: &[Vec<f64>],
    start: Option<&[f64]>,
    ranges: &[(f64, f64)],
) -> Vec<usize> {
    let n = poses.len();
    if n == 0 {
        return Vec::new();
    }
    let between: Vec<Vec<f64>> = poses
        .iter()
        .map(|a| poses.iter().map(|b| distance(a, b, ranges)).collect())
        .collect();
    let from_start: Vec<f64> = poses
        .iter()
        .map(|p| start.map_or(0.0, |s| distance(s, p, ranges)))
        .collect();
    let nearest = |left: &[usize], way: &dyn Fn(usize) -> f64| {
        (0..left.len()).min_by(|a, b| way(left[*a]).total_cmp(&way(left[*b])))
    };
    let mut left: Vec<usize> = (0..n).collect();
    let mut order = Vec::with_capacity(n);
    while let Some(next) = match order.last() {
        None => nearest(&left, &|i| from_start[i]),
        Some(last) => {
            let last: usize = *last;
            nearest(&left, &|i| between[last][i])
        }
    } {
        order.push(left.swap_remove(next));
    }
    improve(&mut order, &between, &from_start);
    order
}

/// 2-opt: reverses parts of the path as long as that shortens it.
fn improve(order: &mut [usize], between: &[Vec<f64>], from_start: &[f64]) {
    let n = order.len();
    let into = |order: &[usize], first: usize, to: usize| match first {
        0 => from_start[to],
        _ => between[order[first - 1]][to],
    };
    let out_of = |order: &[usize], last: usize, from: usize| match order.get(last + 1) {
        None => 0.0,
        Some(next) => between[from][*next],
    };
    loop {
        let mut shortened = false;
        for first in 0..n {
            for last in first + 1..n {
                let (a, b) = (order[first], order[last]);
                let before = into(order, first, a) + out_of(order, last, b);
                let after = into(order, first, b) + out_of(order, last, a);
                if after < before - 1e-12 {
                    order[first..=last].reverse();
                    shortened = true;
                }
            }
        }
        if !shortened {
            return;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Points of a line in disorder: the way along the line is the shortest.
    #[test]
    fn a_line_is_walked_along() {
        let places = [5.0, 1.0, 9.0, 3.0, 7.0, 2.0, 8.0, 4.0, 6.0, 0.0];
        let poses: Vec<Vec<f64>> = places.iter().map(|x| vec![*x, 0.0]).collect();
        let ranges = [(0.0, 10.0), (0.0, 1.0)];
        let order = shortest_path_order(&poses, Some(&[0.0, 0.0]), &ranges);
        let walked: Vec<f64> = order.iter().map(|i| places[*i]).collect();
        assert_eq!(walked, [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0]);
        let way = length(order.iter().map(|i| &poses[*i]), &ranges);
        assert!((way - 0.9).abs() < 1e-12);
    }

    /// Every pose once, and never longer than the given order.
    #[test]
    fn every_pose_comes_once_on_a_shorter_way() {
        let poses: Vec<Vec<f64>> = (0..40_u32)
            .map(|i| {
                let x = f64::from(i.wrapping_mul(2_654_435_761) % 1000);
                let y = f64::from(i.wrapping_mul(40_503) % 997);
                vec![x, y]
            })
            .collect();
        let ranges = [(0.0, 1000.0), (0.0, 997.0)];
        let order = shortest_path_order(&poses, None, &ranges);
        let mut sorted = order.clone();
        sorted.sort_unstable();
        assert_eq!(sorted, (0..40).collect::<Vec<_>>());
        let way = length(order.iter().map(|i| &poses[*i]), &ranges);
        assert!(way < 0.5 * length(&poses, &ranges), "{way}");
        assert!(shortest_path_order(&[], None, &ranges).is_empty());
    }
}
