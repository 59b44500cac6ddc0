//! The parts of a page.

use maud::{Render, html};

use crate::report::*;

#[test]
fn numbers_carry_their_value_and_their_place() {
    let number = Number::mm(0.054_71, "/held_out/calibrated/position_mm/mean");
    let expected =
        r#"<data value="0.05471" data-json="/held_out/calibrated/position_mm/mean">0.055</data>"#;
    assert_eq!(number.render().into_string(), expected);
    assert_eq!(rounded(-0.000_4, 3), "0.000");
    assert_eq!(rounded(-0.000_6, 3), "-0.001");
    let share = Number::percent(0.684, "/x").render().into_string();
    assert_eq!(share, r#"<data value="0.684" data-json="/x">68</data>"#);
}

#[test]
fn plots_stand_where_they_were_put_and_tables_beside_them() {
    let section = Section::new("one", "One & two")
        .text(html! { "first" })
        .figure(html! { "finding" }, html! { svg {} }, "note")
        .table_beside(&["a", "<b>"], vec![vec![html! { "1" }, html! { "2" }]])
        .missing("not <shown>");
    let page = Page::new("Title <1>", "sub").with(section).render();
    let location = |word: &str| page.find(word).unwrap_or_else(|| panic!("{word}: {page}"));
    assert!(location("One &amp; two") < location("<p>first</p>"));
    assert!(location("<p>first</p>") < location("<figcaption>finding"));
    assert!(location("<figcaption>finding") < location("<th>&lt;b&gt;"));
    assert!(location("<th>&lt;b&gt;") < location("not &lt;shown&gt;"));
    assert!(location("<title>Title &lt;1&gt;</title>") < location("<h1>Title &lt;1&gt;"));
    // A page of one section needs no list of contents.
    assert!(!page.contains("<nav"));
}
