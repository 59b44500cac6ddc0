//! Arbitrary names on a page of the report.

use maud::html;
use poegp_trainer::report::{Column, Page, Section};

/// Renders a page on which every name is `bytes`.
///
/// # Panics
/// When a law is broken.
pub fn report(bytes: &[u8]) {
    // An empty heading is left out with its tags, so the name is never empty.
    let name = format!("a{}", String::from_utf8_lossy(bytes));
    let page = page(&name);
    // Backticks alone have a meaning: in a sentence, the text between two of them is code.
    let ordinary: String = name
        .chars()
        .map(|c| if c == '`' { c } else { 'o' })
        .collect();
    let ordinary = self::page(&ordinary);
    for mark in ['<', '>', '"'] {
        let count = |text: &str| text.matches(mark).count();
        // Text keeps its `>` only when it is escaped, like the others.
        assert_eq!(count(&page), count(&ordinary), "{mark} of {name:?}");
    }
    let mut references = page.match_indices('&');
    let known = ["amp;", "lt;", "gt;", "quot;"];
    let stray = references.find(|(at, _)| !known.iter().any(|r| page[at + 1..].starts_with(r)));
    assert_eq!(stray, None, "a stray & of {name:?}");
}

fn page(name: &str) -> String {
    let section = Section::new("one", name)
        .text(html! { (name) })
        .missing(name)
        .figure(
            html! { (name) },
            html! { svg { title { (name) } text x=(name) { (name) } } },
            name,
        )
        .table(&[name], vec![vec![html! { (name) }]])
        .poses(
            &[
                Column::Name(name.to_owned()),
                Column::Error(name.to_owned()),
            ],
            vec![vec![html! { (name) }, html! { (name) }]],
            Some(name),
        );
    let more = (0..4).map(|_| Section::new("two", name).text(html! { a href=(name) { (name) } }));
    let page = Page::new(name, name).with(section);
    more.fold(page, Page::with).render()
}
