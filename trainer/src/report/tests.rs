//! The parts of a page.

use maud::{Render, html};

use crate::report::*;
use poegp_calibration::numeric::statistics::PoseError;
use poegp_calibration::validation::held_out::HeldOutPose;

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

/// Held-out errors of so many poses of a six-joint arm, by five models.
fn evidence(poses: usize) -> ReportData {
    let random = |i: usize, j: usize| ((i * 7919 + j * 104_729) % 10_007) as f64 / 10_007.0;
    let pose = |i: usize, size: f64| {
        let at = |j: usize| random(i, j + 1) - 0.5;
        let residual = [0, 1, 2, 3, 4, 5].map(|j| 2.0 * size * at(j + 10));
        let length = residual[..3].iter().map(|x| x * x).sum::<f64>().sqrt();
        HeldOutPose {
            error: PoseError {
                position_mm: 1e3 * length,
                orientation_mrad: Some(1e3 * residual[3].abs()),
            },
            position: [0, 1, 2].map(|j| 3.0 * at(j)),
            residual,
            sigma: Some([size; 6]),
            noise: Default::default(),
        }
    };
    let names = ["base-tool", "poe", "poe-gp", "poe-gp-load", "elastic"];
    let method = |(k, name): (usize, &&str)| data::Method {
        name: (*name).to_owned(),
        poses: (0..poses)
            .map(|i| pose(i, 2e-3 / 3f64.powi(k as i32)))
            .collect(),
    };
    let row = |i: usize| Row {
        file: "measurements-of-a-robot.csv".to_owned(),
        line: i + 2,
        joints: (0..6).map(|j| 5.0 * random(i, j + 20) - 2.5).collect(),
        payload_kg: Some((i % 5) as f64),
        tool: format!("session {}, target", i % 3),
    };
    ReportData {
        how: HoldOutMethod::TestSets,
        rows: (0..poses).map(row).collect(),
        methods: names.iter().enumerate().map(method).collect(),
        never_held_out: 0,
        nominal: 0,
        calibrated: 4,
        kinds: vec![poegp_protocol::JointKind::Revolute; 6],
        learning: Vec::new(),
    }
}

fn held_out_page(poses: usize) -> String {
    let evidence = evidence(poses);
    let summary = evidence.summary();
    let page = Page::new("Calibration", "").with(sections::headline(&evidence, &summary));
    sections::held_out(page, &evidence, &summary)
        .with(sections::outliers(&evidence, &summary, Ok(&[])))
        .render()
}

#[test]
fn pages_of_many_poses_are_small_quick_and_say_what_they_leave_out() {
    for (poses, thinned) in [(data::DRAWN, false), (5_000, true)] {
        let begin = std::time::Instant::now();
        let page = held_out_page(poses);
        let seconds = begin.elapsed().as_secs_f64();
        // A calibration has parameters, provenance and a verdict beside these: 100 kB are left to them.
        assert!(page.len() < 900_000, "{poses}: {} bytes", page.len());
        assert!(seconds < 1.5 || thinned, "{poses}: {seconds} s");
        let dots = |part: &str| part.matches("h0").count();
        let joints = page.split("id=\"joints\"").nth(1).unwrap();
        let joints = joints.split("</section>").next().unwrap();
        assert_eq!(dots(joints), 2 * 6 * data::DRAWN);
        let table = page.split("<table id=\"poses\">").nth(1).unwrap();
        let table = table.split("</table>").next().unwrap();
        assert_eq!(table.matches("<tr>").count(), 1 + data::DRAWN);
        let said = format!("Of {poses} poses the plots have dots for 700");
        assert_eq!(page.contains(&said), thinned);
        assert_eq!(page.contains(&format!("All {poses} poses")), !thinned);
        println!("{poses} poses: {} bytes in {seconds:.3} s", page.len());
    }
}

/// What would end the script early, or make its bytes others than those of its hash; a page counts no `&` of names wrongly.
#[test]
fn the_script_is_text_that_a_browser_leaves_as_it_is() {
    for word in ["</", "<!--", "\r", "&", "innerHTML", "http"] {
        assert!(!SCRIPT.contains(word), "{word}");
    }
    assert!(!STYLE.contains("</"), "{STYLE}");
    assert!(!STYLE.contains('\r'));
}
