//! Plots as inline SVG.
//!
//! Drawn elements have a class and no colour: the style sheet has the colours, also for dark pages and for paper. Marks are
//! one `path` for each series, not an element for each point, so that a thousand poses stay small. Coordinates have one
//! decimal of a unit that is about a pixel.
//!
//! Dots of poses have the attribute `data-poses`, and their plot states where its plane is (`data-plane`: left, top, width,
//! height) and which values are at its left and right ends (`data-x`). From these and the path itself, `script.js` finds the
//! pose under the pointer; no coordinate is written twice.

mod axis;

use maud::{Markup, html};

use crate::report::chart::axis::with_room;
pub use crate::report::chart::axis::{Axis, Scale, plain, round_125};

/// Series of a mark, which determines its colour.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Series {
    /// The nominal robot.
    Nominal,
    /// The calibrated robot.
    Calibrated,
    /// Neither of the two.
    Other,
    /// Reference with which the others are compared.
    Reference,
}

impl Series {
    fn class(self) -> &'static str {
        match self {
            Self::Nominal => "nominal",
            Self::Calibrated => "calibrated",
            Self::Other => "other",
            Self::Reference => "reference",
        }
    }
}

/// A box of a box plot.
#[derive(Clone, Debug)]
pub struct BoxOf {
    /// Name beside the box.
    pub name: String,
    /// Series, which determines the colour.
    pub series: Series,
    /// Quantiles below which 5, 25, 50, 75 and 95 % of the values are.
    pub quantiles: [f64; 5],
    /// Arithmetic mean.
    pub mean: f64,
    /// Largest value.
    pub max: f64,
}

impl BoxOf {
    /// Computes the box of `values`; `None` when there are none.
    pub fn new(name: impl Into<String>, series: Series, values: &[f64]) -> Option<Self> {
        let mut sorted = values.to_vec();
        sorted.sort_by(f64::total_cmp);
        let max = *sorted.last()?;
        let share = |p| poegp_calibration::numeric::statistics::percentile(&sorted, p);
        Some(Self {
            name: name.into(),
            series,
            quantiles: [0.05, 0.25, 0.5, 0.75, 0.95].map(share),
            mean: sorted.iter().sum::<f64>() / sorted.len() as f64,
            max,
        })
    }
}

/// Margins around the plane, in units of the drawing.
const RIGHT: f64 = 12.0;
const TOP: f64 = 10.0;
const BOTTOM: f64 = 40.0;
const LEFT: f64 = 54.0;
/// Approximate width of a character of the labels.
const CHARACTER: f64 = 6.3;
/// Approximate height of the characters of a label.
const LINE: f64 = 11.5;
/// Number of dots above which the dots are drawn smaller.
const MANY: usize = 350;
/// Largest number of characters of a name beside a box.
const NAME: usize = 20;

/// A plane with two axes, and the marks on it.
#[derive(Debug)]
pub struct Plot {
    x: Axis,
    y: Axis,
    width: f64,
    height: f64,
    left: f64,
    y_ticks: bool,
    marks: Vec<Markup>,
    /// How dots of poses are marked; `None` without such dots.
    poses: Option<Brush>,
}

/// Poses that dragging over a plot marks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Brush {
    /// The poses between two values of x.
    Range,
    /// The poses in a rectangle.
    Rectangle,
}

impl Plot {
    /// Creates an empty plane of the usual size.
    pub fn new(x: Axis, y: Axis) -> Self {
        Self {
            x,
            y,
            width: 440.0,
            height: 270.0,
            left: LEFT,
            y_ticks: true,
            marks: Vec::new(),
            poses: None,
        }
    }

    /// Sets the size of this chart.
    #[must_use]
    pub fn sized(mut self, width: f64, height: f64) -> Self {
        (self.width, self.height) = (width, height);
        self
    }

    fn plane(&self) -> (f64, f64) {
        (self.width - self.left - RIGHT, self.height - TOP - BOTTOM)
    }

    fn at(&self, x: f64, y: f64) -> (f64, f64) {
        let (width, height) = self.plane();
        (
            self.left + width * self.x.location(x),
            TOP + height * (1.0 - self.y.location(y)),
        )
    }

    /// Draws a dot for each point.
    pub fn dots(&mut self, series: Series, points: impl IntoIterator<Item = (f64, f64)>) {
        let mut d = String::new();
        for (x, y) in points {
            let (x, y) = self.at(x, y);
            d += &format!("M{} {}h0", short(x), short(y));
        }
        let class = format!("dots {}", series.class());
        self.marks.push(html! { path class=(class) d=(d) {} });
    }

    /// Draws a dot for each pose, with its row in the table of the poses (see [`Section::poses`](super::Section::poses)).
    pub fn poses(
        &mut self,
        series: Series,
        brush: Brush,
        points: impl IntoIterator<Item = (usize, (f64, f64))>,
    ) {
        let (mut d, mut rows) = (String::new(), Vec::new());
        for (row, (x, y)) in points {
            let (x, y) = self.at(x, y);
            d += &format!("M{} {}h0", short(x), short(y));
            rows.push(row);
        }
        if rows.is_empty() {
            return;
        }
        let many = rows.len() > MANY;
        // Most plots have all rows in their order and need not list them.
        let in_order = rows.iter().enumerate().all(|(i, row)| i == *row);
        let rows: Vec<String> = rows.iter().map(ToString::to_string).collect();
        let rows = if in_order {
            String::new()
        } else {
            rows.join(" ")
        };
        let size = if many { " many" } else { "" };
        let class = format!("dots {}{size}", series.class());
        self.marks
            .push(html! { path class=(class) data-poses=(rows) d=(d) {} });
        self.poses = Some(brush);
    }

    /// Draws a line through the points, with a dot at each when `dotted`.
    pub fn line(&mut self, series: Series, points: &[(f64, f64)], dotted: bool) {
        let mut d = String::new();
        for (i, (x, y)) in points.iter().enumerate() {
            let (x, y) = self.at(*x, *y);
            d += &format!(
                "{}{} {}",
                if i == 0 { 'M' } else { 'L' },
                short(x),
                short(y)
            );
        }
        let class = format!("line {}", series.class());
        // A rim behind the line, in the colour of the page, makes it stand out from dots.
        self.marks
            .push(html! { path class="rim" d=(d) {} path class=(class) d=(d) {} });
        if dotted {
            self.dots(series, points.iter().copied());
        }
    }

    /// Draws bars from the lower end of the y axis; each has left, right and height.
    pub fn bars(&mut self, series: Series, bars: &[(f64, f64, f64)]) {
        let mut d = String::new();
        for (from, to, height) in bars.iter().filter(|b| b.2 > 0.0) {
            let ((left, top), (right, bottom)) =
                (self.at(*from, *height), self.at(*to, self.y.lower));
            d += &rectangle([left, right], [bottom, top]);
        }
        let class = format!("bar {}", series.class());
        self.marks.push(html! { path class=(class) d=(d) {} });
    }

    /// Draws a line across the plane at `x`, with a short text at its upper end.
    pub fn upright(&mut self, series: Series, x: f64, texts: &str) {
        let ((x, top), (_, bottom)) = (self.at(x, self.y.upper), self.at(x, self.y.lower));
        let class = format!("rule {}", series.class());
        let (end, anchor) = if x > self.width * 0.6 {
            (x - 4.0, "end")
        } else {
            (x + 4.0, "start")
        };
        self.marks.push(html! {
            path class=(class) d=(format!("M{} {}V{}", short(x), short(top), short(bottom))) {}
            text class="note" x=(short(end)) y=(short(top + 11.0)) text-anchor=(anchor) { (texts) }
        });
    }

    /// Draws a line across the plane at `y`, with a short text below its left end.
    pub fn level(&mut self, series: Series, y: f64, texts: &str) {
        let ((left, y), (right, _)) = (self.at(self.x.lower, y), self.at(self.x.upper, y));
        let class = format!("rule {}", series.class());
        self.marks.push(html! {
            path class=(class) d=(format!("M{} {}H{}", short(left), short(y), short(right))) {}
            text class="note" x=(short(left + 4.0)) y=(short(y + 13.0)) { (texts) }
        });
    }

    /// Draws a thick arrow from a point by a displacement in the units of the axes; `title` describes it.
    pub fn arrow(&mut self, series: Series, [x, y, dx, dy]: [f64; 4], title: &str) {
        let ((x, y), (u, v)) = (self.at(x, y), self.at(x + dx, y + dy));
        let (length, angle) = ((u - x).hypot(v - y), (v - y).atan2(u - x));
        let mut d = format!("M{} {}L{} {}", short(x), short(y), short(u), short(v));
        let head = (0.4 * length).min(6.0);
        if head >= 1.0 {
            let side = |turn: f64| {
                let a = angle + turn;
                (short(u + head * a.cos()), short(v + head * a.sin()))
            };
            let ((a, b), (c, e)) = (side(2.6), side(-2.6));
            d += &format!("M{a} {b}L{} {}L{c} {e}", short(u), short(v));
        }
        let class = format!("arrow {}", series.class());
        self.marks
            .push(html! { path class=(class) d=(d) { title { (title) } } });
    }

    /// Draws a frame around a part of the plane, with a short text inside its upper left corner.
    pub fn frame(&mut self, series: Series, low: (f64, f64), high: (f64, f64), texts: &str) {
        let ((left, bottom), (right, top)) = (self.at(low.0, low.1), self.at(high.0, high.1));
        let class = format!("rule {}", series.class());
        let d = rectangle([left, right], [bottom, top]);
        self.marks.push(html! {
            path class=(class) d=(d) {}
            text class="note" x=(short(left + 3.0)) y=(short(top - 4.0)) { (texts) }
        });
    }

    /// Returns the drawing; `aria_label` describes it for screen readers.
    pub fn render(&self, aria_label: &str) -> Markup {
        let (width, height) = self.plane();
        let (right, bottom) = (self.left + width, TOP + height);
        let ticks_x = self
            .x
            .ticks()
            .into_iter()
            .map(|(value, text)| (self.left + width * self.x.location(value), text));
        let ticks_y = self
            .y
            .ticks()
            .into_iter()
            .map(|(value, text)| (TOP + height * (1.0 - self.y.location(value)), text));
        let (ticks_x, ticks_y): (Vec<_>, Vec<_>) = (ticks_x.collect(), ticks_y.collect());
        let labels_x = labelled(&self.x, &ticks_x, |text| {
            CHARACTER * (text.chars().count() as f64 + 1.0)
        });
        let labels_y = labelled(&self.y, &ticks_y, |_| LINE);
        let mut grid = String::new();
        for (x, _) in &ticks_x {
            grid += &format!("M{} {}V{}", short(*x), short(TOP), short(bottom));
        }
        for (y, _) in ticks_y.iter().filter(|_| self.y_ticks) {
            grid += &format!("M{} {}H{}", short(self.left), short(*y), short(right));
        }
        let middle = TOP + height / 2.0;
        let plane = [self.left, TOP, width, height].map(short).join(" ");
        let ends = format!("{} {}", self.x.lower as f32, self.x.upper as f32);
        let (plane, ends) = (self.poses.map(|_| plane), self.poses.map(|_| ends));
        let brush = self.poses.filter(|b| *b == Brush::Rectangle);
        html! {
            svg viewBox=(format!("0 0 {} {}", short(self.width), short(self.height))) role="img" aria-label=(aria_label)
                data-plane=[plane] data-x=[ends] data-brush=[brush.map(|_| "rectangle")] {
                path class="grid" d=(grid) {}
                @for (x, text) in labels_x {
                    text class="tick" x=(short(*x)) y=(short(bottom + 15.0)) text-anchor="middle" { (text) }
                }
                @if self.y_ticks {
                    @for (y, text) in labels_y {
                        text class="tick" x=(short(self.left - 6.0)) y=(short(y + 4.0)) text-anchor="end" { (text) }
                    }
                    text class="label" x="12" y=(short(middle)) text-anchor="middle"
                        transform=(format!("rotate(-90 12 {})", short(middle))) { (self.y.label) }
                }
                @for mark in &self.marks { (mark) }
                path class="axis" d=(format!("M{} {}V{}H{}", short(self.left), short(TOP), short(bottom), short(right))) {}
                text class="label" x=(short(self.left + width / 2.0)) y=(short(self.height - 5.0)) text-anchor="middle" {
                    (self.x.label)
                }
            }
        }
    }
}

/// Returns boxes on one axis, one below the other: quartiles, whiskers at 5 and 95 %, a diamond at the mean, a dot at the
/// largest value.
pub fn boxes(label: &str, boxes: &[BoxOf], aria_label: &str) -> Markup {
    let ends = boxes.iter().flat_map(|b| [b.quantiles[0], b.max]);
    let largest = ends.clone().fold(0.0, f64::max);
    let medians = boxes.iter().map(|b| b.quantiles[2]);
    let smallest = medians.fold(f64::INFINITY, f64::min);
    let x = if largest > 12.0 * smallest {
        Axis::log(label, ends.fold(f64::INFINITY, f64::min), largest)
    } else {
        Axis::linear(label, 0.0, 1.04 * largest)
    };
    let row = if boxes.len() > 7 { 24.0 } else { 32.0 };
    let longest = boxes.iter().map(|b| b.name.chars().count().min(NAME)).max();
    let mut plot = Plot::new(x, Axis::linear("", 0.0, boxes.len() as f64));
    plot.height = TOP + BOTTOM + row * boxes.len() as f64;
    plot.left = 14.0 + CHARACTER * longest.unwrap_or(0) as f64;
    plot.y_ticks = false;
    for (i, b) in boxes.iter().enumerate() {
        let middle = boxes.len() as f64 - i as f64 - 0.5;
        let at = |x: f64| plot.at(x, middle);
        let [(a, y), (q1, _), (m, _), (q3, _), (z, _)] = b.quantiles.map(at);
        let half = 0.3 * row;
        let class = format!("box {}", b.series.class());
        let whiskers = format!(
            "M{} {y}H{}M{} {y}H{}M{} {}v{}M{} {}v{}",
            short(a),
            short(q1),
            short(q3),
            short(z),
            short(a),
            short(y - half / 2.0),
            short(half),
            short(z),
            short(y - half / 2.0),
            short(half),
            y = short(y)
        );
        let mean = at(b.mean).0;
        let name = shortened(&b.name);
        let drawn = html! {
            g class=(class) {
                title { (b.name) }
                path class="whisker" d=(whiskers) {}
                rect x=(short(q1)) y=(short(y - half)) width=(short((q3 - q1).max(0.5))) height=(short(2.0 * half)) {}
                path class="median" d=(format!("M{} {}v{}", short(m), short(y - half), short(2.0 * half))) {}
                path class="mean" d=(format!("M{} {}l4 4l-4 4l-4 -4z", short(mean), short(y - 4.0))) {}
                circle cx=(short(at(b.max).0)) cy=(short(y)) r="2.5" {}
                text class="tick name" x=(short(plot.left - 8.0)) y=(short(y + 4.0)) text-anchor="end" { (name) }
            }
        };
        plot.marks.push(drawn);
    }
    plot.render(aria_label)
}

/// Returns the ticks of an axis whose labels have room; `length` returns the length of a label on the axis.
fn labelled<'a>(
    axis: &Axis,
    ticks: &'a [(f64, String)],
    length: impl Fn(&str) -> f64,
) -> Vec<&'a (f64, String)> {
    let texts: Vec<String> = ticks.iter().map(|t| t.1.clone()).collect();
    let locations: Vec<f64> = ticks.iter().map(|t| t.0).collect();
    let lengths: Vec<f64> = texts.iter().map(|text| length(text)).collect();
    let shown = match axis.scale {
        Scale::Linear => vec![true; ticks.len()],
        Scale::Log => with_room(&texts, &locations, &lengths),
    };
    let kept = ticks.iter().zip(shown).filter(|t| t.1);
    kept.map(|t| t.0).collect()
}

/// Shortens a name in its middle to at most [`NAME`] characters and keeps more of its end, where names differ most.
fn shortened(name: &str) -> String {
    let all: Vec<char> = name.chars().collect();
    if all.len() <= NAME {
        return name.to_owned();
    }
    let (head, tail) = (&all[..7], &all[all.len() - (NAME - 8)..]);
    head.iter().chain(['…'].iter()).chain(tail).collect()
}

/// Returns the path of a rectangle between the ends of its sides.
fn rectangle(x: [f64; 2], y: [f64; 2]) -> String {
    let ([left, right], [bottom, top]) = (x.map(short), y.map(short));
    format!("M{left} {bottom}V{top}H{right}V{bottom}z")
}

/// Formats a coordinate with one decimal, or without decimals when this is 0.
fn short(x: f64) -> String {
    let text = format!("{x:.1}");
    match text.strip_suffix(".0") {
        Some("-0") => "0".to_owned(),
        Some(whole) => whole.to_owned(),
        None => text,
    }
}
