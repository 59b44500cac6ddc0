//! Straight segments of an arm, and their distances from each other and from a box.

use nalgebra::Vector3;

/// A box along the axes of the base frame, metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Zone {
    /// Smallest x, y, z.
    pub lower: Vector3<f64>,
    /// Largest x, y, z.
    pub upper: Vector3<f64>,
}

impl Zone {
    /// Returns whether a point is inside.
    pub fn contains(&self, point: &Vector3<f64>) -> bool {
        (0..3).all(|i| (self.lower[i]..=self.upper[i]).contains(&point[i]))
    }
}

/// A straight segment between two points, metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Segment {
    /// One end.
    pub from: Vector3<f64>,
    /// The other end; it may be the same point.
    pub to: Vector3<f64>,
}

impl Segment {
    /// Returns the point at a share of the length: 0 is `from`, 1 is `to`.
    pub fn at(&self, share: f64) -> Vector3<f64> {
        self.from + share * (self.to - self.from)
    }

    /// Returns the length in metres.
    pub fn length(&self) -> f64 {
        (self.to - self.from).norm()
    }

    /// Returns the distance to a point in metres.
    pub fn distance_to_point(&self, point: &Vector3<f64>) -> f64 {
        let along = self.to - self.from;
        let square = along.norm_squared();
        let share = if square > 0.0 {
            (along.dot(&(point - self.from)) / square).clamp(0.0, 1.0)
        } else {
            0.0
        };
        (self.at(share) - point).norm()
    }

    /// Returns the distance to another segment in metres.
    ///
    /// The squared distance is a convex function of the two shares. Its minimum on the unit square is either inside, where
    /// the common perpendicular meets both segments, or on an edge, where one of the points is an end. All of these are
    /// compared, so nearly parallel segments need no threshold.
    pub fn distance(&self, other: &Self) -> f64 {
        let edges = [
            self.distance_to_point(&other.from),
            self.distance_to_point(&other.to),
            other.distance_to_point(&self.from),
            other.distance_to_point(&self.to),
        ];
        let least = edges.into_iter().fold(f64::INFINITY, f64::min);
        let (u, v) = (self.to - self.from, other.to - other.from);
        let apart = self.from - other.from;
        let (uu, uv, vv) = (u.norm_squared(), u.dot(&v), v.norm_squared());
        let (ua, va) = (u.dot(&apart), v.dot(&apart));
        let determinant = uu * vv - uv * uv;
        let s = (uv * va - vv * ua) / determinant;
        let t = (uu * va - uv * ua) / determinant;
        let inside = 0.0..=1.0;
        // For parallel segments the shares are not finite, so they do not count as inside.
        if inside.contains(&s) && inside.contains(&t) {
            least.min((self.at(s) - other.at(t)).norm())
        } else {
            least
        }
    }

    /// Returns the distance to a box in metres; 0 if the segment touches the box.
    ///
    /// Along the segment, the squared distance to a box is convex. It is quadratic between the points where a coordinate
    /// passes a face of the box. The minima of all these pieces are compared.
    pub fn distance_to_box(&self, zone: &Zone) -> f64 {
        let along = self.to - self.from;
        let mut ends = vec![0.0, 1.0];
        for axis in 0..3 {
            for face in [zone.lower[axis], zone.upper[axis]] {
                let share = (face - self.from[axis]) / along[axis];
                if (0.0..=1.0).contains(&share) {
                    ends.push(share);
                }
            }
        }
        ends.sort_by(f64::total_cmp);
        let outside = |share: f64| {
            let point = self.at(share);
            Vector3::from_fn(|i, _| point[i] - point[i].clamp(zone.lower[i], zone.upper[i]))
        };
        let mut least = outside(0.0).norm();
        for piece in ends.windows(2) {
            let middle = 0.5 * (piece[0] + piece[1]);
            // Only coordinates that are outside in this piece change the distance.
            let beyond = outside(middle);
            let slope = Vector3::from_fn(|i, _| if beyond[i] == 0.0 { 0.0 } else { along[i] });
            let square = slope.norm_squared();
            let best = if square > 0.0 {
                (middle - slope.dot(&beyond) / square).clamp(piece[0], piece[1])
            } else {
                middle
            };
            least = least
                .min(outside(best).norm())
                .min(outside(piece[1]).norm());
        }
        least
    }
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;

    const STEPS: usize = 200;

    fn point(random: &mut ChaCha8Rng) -> Vector3<f64> {
        Vector3::from_fn(|_, _| 2.0 * random.random::<f64>() - 1.0)
    }

    /// Segments in general position, parallel, nearly parallel, crossing, of no length.
    fn pairs() -> Vec<(Segment, Segment)> {
        let mut random = ChaCha8Rng::seed_from_u64(7);
        let mut out = Vec::new();
        for k in 0..400 {
            let [from, to, c, d] = [(); 4].map(|()| point(&mut random));
            let first = Segment { from, to };
            let along = to - from;
            let tilt = 10_f64.powi(-(k % 17)) * d;
            let second = match k % 5 {
                0 => Segment { from: c, to: d },
                1 => Segment {
                    from: c,
                    to: c + 0.7 * along,
                },
                2 => Segment {
                    from: c,
                    to: c - 0.7 * along + tilt,
                },
                3 => Segment {
                    from: first.at(0.3) - 0.4 * d,
                    to: first.at(0.3) + d,
                },
                _ => Segment { from: c, to: c },
            };
            out.push((first, second));
        }
        out
    }

    fn sampled(first: &Segment, of_point: impl Fn(&Vector3<f64>) -> f64) -> f64 {
        (0..=STEPS)
            .map(|i| of_point(&first.at(i as f64 / STEPS as f64)))
            .fold(f64::INFINITY, f64::min)
    }

    /// Never above any sampled pair of points, and never below the best of them by more than the step between samples.
    #[test]
    fn the_distance_of_segments_is_that_of_their_nearest_points() {
        for (first, second) in pairs() {
            let found = first.distance(&second);
            let best = sampled(&first, |a| sampled(&second, |b| (a - b).norm()));
            let step = (first.length() + second.length()) / (2 * STEPS) as f64;
            assert!(
                found <= best + 1e-12,
                "{first:?} {second:?}: {found} > {best}"
            );
            assert!(
                found >= best - step,
                "{first:?} {second:?}: {found} < {best}"
            );
            assert!((found - second.distance(&first)).abs() < 1e-9);
        }
    }

    #[test]
    fn the_distance_of_a_box_is_that_of_the_nearest_point() {
        let mut random = ChaCha8Rng::seed_from_u64(8);
        let mut touching = 0;
        for (first, second) in pairs() {
            let middle = point(&mut random);
            let half = point(&mut random).map(|x| 0.05 + 0.5 * x.abs());
            let zone = Zone {
                lower: middle - half,
                upper: middle + half,
            };
            for segment in [first, second] {
                let outside = |p: &Vector3<f64>| {
                    let clamped = Vector3::from_fn(|i, _| p[i].clamp(zone.lower[i], zone.upper[i]));
                    (p - clamped).norm()
                };
                let found = segment.distance_to_box(&zone);
                let best = sampled(&segment, outside);
                let step = segment.length() / (2 * STEPS) as f64;
                assert!(
                    found <= best + 1e-12,
                    "{segment:?} {zone:?}: {found} > {best}"
                );
                assert!(
                    found >= best - step - 1e-12,
                    "{segment:?} {zone:?}: {found} < {best}"
                );
                touching += usize::from(found == 0.0);
            }
        }
        assert!(touching > 50, "{touching}");
    }
}
