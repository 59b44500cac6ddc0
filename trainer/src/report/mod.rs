//! Reports: one self-contained HTML page about a calibration.
//!
//! A [`Page`] is a title and sections; a [`Section`] is text, figures and tables, or a sentence that says why there is
//! nothing to show. The sections that several commands share are in [`sections`]. They are made from [`ReportData`],
//! held-out errors pose by pose, so that `trainer check` or another command only creates [`ReportData`] and picks its
//! sections:
//!
//! ```text
//! ReportData ──> summary (part `held_out` of --json) ────┐
//!     └───────────────────────────────────────────> sections::* ──> Page ──> bytes
//! ```
//!
//! The page requests nothing from a network. A page with plots of poses has one script, `script.js`, which makes these plots
//! react to the pointer; it reads the table of the poses ([`Section::poses`]) and adds no number of its own to the text, and
//! everything else works without it. The content security policy of the page (`policy.rs`) allows this script and the style
//! sheet by their hashes and nothing else. Colours are CSS variables, also inside the SVG, so that the page follows the
//! reader's light or dark scheme and prints in light. Every name given by a user (files, sessions, robots) goes through the
//! escaping of `maud`. A number that is also in the JSON document is a `data` element with its exact value and its position
//! there (a JSON pointer): [`Number`]; a test compares them all. The same input gives the same bytes.

pub mod certificate;
pub mod chart;
pub mod controller;
pub mod data;
mod policy;
pub mod provenance;
pub mod sections;
#[cfg(test)]
mod tests;

use maud::{DOCTYPE, Markup, PreEscaped, html};

pub use crate::report::data::{
    HeldOutSummary, HoldOutMethod, Method, ReportData, Row, never_held_out,
};
pub use crate::report::provenance::{FileSummary, Provenance};

const STYLE: &str = include_str!("style.css");
const SCRIPT: &str = include_str!("script.js");

/// A column of the table of the poses.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Column {
    /// Name of the row in its file: its line.
    Name(String),
    /// The error of the pose, by which marked poses are compared.
    Error(String),
    /// Number of a joint, from 1, and its unit.
    Joint(usize, &'static str),
    /// Any other column.
    Other(String),
}

/// A number of the JSON document.
#[derive(Clone, Debug)]
pub struct Number {
    value: f64,
    text: String,
    pointer: String,
}

impl Number {
    /// Creates a number with this many decimals; `pointer` (RFC 6901) is its position in the document that `--json` writes.
    pub fn new(value: f64, decimals: usize, pointer: impl Into<String>) -> Self {
        Self {
            value,
            text: rounded(value, decimals),
            pointer: pointer.into(),
        }
    }

    /// Creates a length in mm, to the micrometre.
    pub fn mm(value: f64, pointer: impl Into<String>) -> Self {
        Self::new(value, 3, pointer)
    }

    /// Creates a count.
    pub fn count(value: usize, pointer: impl Into<String>) -> Self {
        Self::new(value as f64, 0, pointer)
    }

    /// Creates a share in per cent, without the per cent sign.
    pub fn percent(share: f64, pointer: impl Into<String>) -> Self {
        Self {
            text: format!("{:.0}", 100.0 * share),
            ..Self::new(share, 0, pointer)
        }
    }
}

impl maud::Render for Number {
    fn render(&self) -> Markup {
        html! { data value=(self.value) data-json=(self.pointer) { (self.text) } }
    }
}

/// Formats a number with this many decimals; a number that rounds to zero has no sign.
pub fn rounded(value: f64, decimals: usize) -> String {
    let text = format!("{value:.decimals$}");
    match text.strip_prefix('-') {
        Some(rest) if rest.chars().all(|c| c == '0' || c == '.') => rest.to_owned(),
        _ => text,
    }
}

/// Renders a sentence that a terminal shows, too: the text between two backticks is code.
pub fn sentence(text: &str) -> Markup {
    html! {
        @for (i, part) in text.split('`').enumerate() {
            @if i % 2 == 0 { (part) } @else { code { (part) } }
        }
    }
}

/// Returns a text with a capital letter at the beginning.
pub fn capitalised(text: &str) -> String {
    let mut letters = text.chars();
    let first = letters.next().map(char::to_uppercase);
    first.into_iter().flatten().chain(letters).collect()
}

/// A part of the page under a heading.
#[derive(Debug)]
pub struct Section {
    id: &'static str,
    heading: String,
    blocks: Vec<Markup>,
    figures: Vec<Markup>,
    small: bool,
    scripted: bool,
}

impl Section {
    /// Creates an empty section; `id` is its anchor.
    pub fn new(id: &'static str, heading: impl Into<String>) -> Self {
        Self {
            id,
            heading: heading.into(),
            blocks: Vec::new(),
            figures: Vec::new(),
            small: false,
            scripted: false,
        }
    }

    /// Adds a paragraph.
    #[must_use]
    pub fn text(mut self, text: Markup) -> Self {
        self.close_figures();
        self.blocks.push(html! { p { (text) } });
        self
    }

    /// Adds a sentence that says why something is not shown.
    #[must_use]
    pub fn missing(mut self, why: impl AsRef<str>) -> Self {
        self.close_figures();
        self.blocks
            .push(html! { p class="missing" { (sentence(why.as_ref())) } });
        self
    }

    /// Adds a plot. `finding` is its title, which says in one sentence what it shows; `note` explains its marks.
    #[must_use]
    pub fn figure(mut self, finding: Markup, svg: Markup, note: &str) -> Self {
        self.figures.push(html! {
            figure {
                figcaption { (finding) }
                (svg)
                @if !note.is_empty() { p class="note" { (sentence(note)) } }
            }
        });
        self
    }

    /// Shows the plots in three columns where there is room, instead of two.
    #[must_use]
    pub fn small_figures(mut self) -> Self {
        self.small = true;
        self
    }

    /// Adds a table: the first column has text, the others have numbers.
    #[must_use]
    pub fn table(mut self, header: &[&str], rows: Vec<Vec<Markup>>) -> Self {
        self.close_figures();
        self.blocks.push(table(header, rows));
        self
    }

    /// Adds a table of a few columns beside the plots before it.
    #[must_use]
    pub fn table_beside(mut self, header: &[&str], rows: Vec<Vec<Markup>>) -> Self {
        self.figures.push(table(header, rows));
        self
    }

    /// Adds the table of the poses: one row for each pose that has dots in plots ([`Plot::poses`](chart::Plot::poses)), in
    /// their order. `folded` is the text that is shown until the table is opened. A page has at most one such table.
    #[must_use]
    pub fn poses(
        mut self,
        columns: &[Column],
        rows: Vec<Vec<Markup>>,
        folded: Option<&str>,
    ) -> Self {
        self.close_figures();
        self.scripted = true;
        let table = html! {
            div class="scroll" { table id="poses" {
                thead { tr { @for column in columns { @match column {
                    Column::Error(name) => th data-role="error" { (name) },
                    Column::Joint(joint, unit) => th data-role="joint" data-unit=(unit) { "joint " (joint) " (" (unit) ")" },
                    Column::Name(name) | Column::Other(name) => th { (name) },
                } } } }
                tbody { @for row in rows { tr { @for field in row { td { (field) } } } } }
            } }
        };
        self.blocks.push(match folded {
            Some(title) => html! { details { summary { (title) } (table) } },
            None => table,
        });
        self
    }

    /// Adds a sentence that says how the section's plots react; it is shown where the script runs.
    #[must_use]
    pub fn answers(mut self) -> Self {
        self.close_figures();
        self.blocks.push(html! {
            p class="hint" hidden {
                "Point at a dot, or go to a plot with Tab and through its dots with the arrow keys, to see the pose. Drag over a \
                 plot, or hold Shift, to mark the same poses in all others; Escape clears."
            }
        });
        self
    }

    /// Adds any other block.
    #[must_use]
    pub fn block(mut self, block: Markup) -> Self {
        self.close_figures();
        self.blocks.push(block);
        self
    }

    fn close_figures(&mut self) {
        if !self.figures.is_empty() {
            let figures = std::mem::take(&mut self.figures);
            let class = if self.small {
                "figures small"
            } else {
                "figures"
            };
            self.blocks
                .push(html! { div class=(class) { @for figure in &figures { (figure) } } });
        }
    }
}

fn table(header: &[&str], rows: Vec<Vec<Markup>>) -> Markup {
    html! {
        div class="scroll" { table {
            thead { tr { @for field in header { th { (field) } } } }
            tbody { @for row in rows { tr { @for field in row { td { (field) } } } } }
        } }
    }
}

/// A page of a report.
#[derive(Debug)]
pub struct Page {
    title: String,
    subtitle: String,
    sections: Vec<Section>,
}

impl Page {
    /// Creates an empty page.
    pub fn new(title: impl Into<String>, subtitle: impl Into<String>) -> Self {
        Self {
            title: title.into(),
            subtitle: subtitle.into(),
            sections: Vec::new(),
        }
    }

    /// Adds a section.
    #[must_use]
    pub fn with(mut self, mut section: Section) -> Self {
        section.close_figures();
        self.sections.push(section);
        self
    }

    /// Adds all sections of an iterator.
    pub fn with_all(self, sections: impl IntoIterator<Item = Section>) -> Self {
        sections.into_iter().fold(self, Self::with)
    }

    /// Returns the text of the HTML file.
    pub fn render(&self) -> String {
        let scripted = self.sections.iter().any(|section| section.scripted);
        let script = scripted.then_some(SCRIPT);
        // The table of contents comes behind the leading sections.
        let leading = self
            .sections
            .iter()
            .take_while(|s| s.heading.is_empty())
            .count()
            .max(1);
        let page = html! {
            (DOCTYPE)
            html lang="en" {
                head {
                    meta charset="utf-8";
                    meta http-equiv="Content-Security-Policy" content=(policy::policy(STYLE, script));
                    meta name="viewport" content="width=device-width, initial-scale=1";
                    meta name="color-scheme" content="light dark";
                    meta name="generator" content=(concat!("poegp trainer ", env!("CARGO_PKG_VERSION")));
                    // Without this line, a browser asks the server for an icon.
                    link rel="icon" href="data:,";
                    title { (self.title) }
                    style { (PreEscaped(STYLE)) }
                }
                body {
                    header { h1 { (self.title) } p { (sentence(&self.subtitle)) } }
                    main {
                        @for (i, section) in self.sections.iter().enumerate() {
                            section id=(section.id) {
                                @if !section.heading.is_empty() { h2 { (section.heading) } }
                                @for block in &section.blocks { (block) }
                            }
                            @if i + 1 == leading && self.sections.len() > 3 { (self.contents()) }
                        }
                    }
                    footer {
                        p { "Made by poegp trainer " (env!("CARGO_PKG_VERSION")) ". This page needs no network"
                            @if scripted { "; its script, the only one that it allows, lets the plots answer." } @else { " and no scripts." }
                        }
                    }
                    @if let Some(script) = script { script { (PreEscaped(script)) } }
                }
            }
        };
        page.into_string() + "\n"
    }

    fn contents(&self) -> Markup {
        html! {
            nav aria-label="Contents" { ul {
                @for section in self.sections.iter().filter(|s| !s.heading.is_empty()) {
                    li { a href=(format!("#{}", section.id)) { (section.heading) } }
                }
            } }
        }
    }
}
