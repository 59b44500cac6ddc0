//! The pages of the report in a browser: complete without their script, without complaints, interactive with it, and legible.
//!
//! What the plots show is compared with the measurement files, not with the page.

mod answers;
mod chromium;
mod guide;

use serde_json::{Value, json};

use crate::browser::chromium::{Browser, SHIFT};
use crate::program::{Folder, SERIAL, changed, simulated};
use crate::report::is_rounded;

const PAGE: &str = include_str!("page.js");

/// Returns a folder with measurements and, for each command that plots poses, its page and JSON document.
fn pages() -> (Folder, Vec<(&'static str, &'static str)>) {
    let folder = Folder::new();
    folder.write("train.csv", simulated("train", 60));
    folder.write("test.csv", simulated("test1", 20));
    let line = format!("calibrate --robot {SERIAL} train.csv --method poe-gp-load --out a.blob");
    folder
        .run(&format!(
            "{line} --report calibrate.html --json calibrate.json"
        ))
        .ok();
    let line = format!(
        "compare --robot {SERIAL} train.csv --folds 0 --test test.csv --methods poe,poe-gp"
    );
    folder
        .run(&format!("{line} --report compare.html --json compare.json"))
        .ok();
    let line = "check a.blob test.csv --max-mm 9 --report check.html --json check.json";
    folder.run(line).ok();
    let program = std::fs::read(crate::program::data("programs/part.mod")).unwrap();
    folder.write("part.mod", program);
    let line = "correct a.blob part.mod --payload-kg 2.5 --out out.mod --report correct.html --json correct.json";
    folder.run(line);
    let files = [
        ("calibrate.html", "calibrate.json"),
        ("compare.html", "compare.json"),
        ("check.html", "check.json"),
        ("correct.html", "correct.json"),
    ];
    (folder, files.to_vec())
}

/// Opens a page and loads the helper functions of the tests.
#[track_caller]
fn open(browser: &mut Browser, folder: &Folder, page: &str) {
    browser.open(&folder.path(page));
    assert_eq!(browser.evaluate(PAGE), true);
}

#[track_caller]
fn silent(browser: &Browser) {
    assert!(browser.complaints.is_empty(), "{:#?}", browser.complaints);
    for url in &browser.requests {
        assert!(url.starts_with("file://") || url == "data:,", "{url}");
    }
}

#[test]
fn every_word_and_number_is_there_without_the_script_and_nothing_complains() {
    let Some(mut browser) = Browser::start("reports") else {
        return;
    };
    let (folder, pages) = pages();
    for (page, document) in pages {
        browser.call(
            "Emulation.setScriptExecutionDisabled",
            json!({"value": true}),
        );
        open(&mut browser, &folder, page);
        assert_eq!(
            browser.evaluate("document.querySelectorAll('.tip').length"),
            0,
            "{page}"
        );
        let without = browser.text("tests.text()");
        browser.call(
            "Emulation.setScriptExecutionDisabled",
            json!({"value": false}),
        );
        open(&mut browser, &folder, page);
        assert_eq!(
            browser.evaluate("document.querySelectorAll('.tip').length"),
            1,
            "{page}"
        );
        // A box and marks do not change the text.
        browser.evaluate("document.querySelector('svg[data-plane]').focus()");
        browser.press("End", SHIFT);
        assert!(!browser.text("tests.panel()").is_empty(), "{page}");
        assert_eq!(browser.text("tests.text()"), without, "{page}");
        let document = folder.json(document);
        let numbers = browser.evaluate("tests.numbers()");
        let numbers = numbers.as_array().unwrap();
        assert!(numbers.len() > 10, "{page}: {}", numbers.len());
        for number in numbers {
            let (pointer, value) = (number[0].as_str().unwrap(), number[1].as_f64().unwrap());
            let there = document.pointer(pointer).and_then(Value::as_f64);
            assert_eq!(there, Some(value), "{page}: {pointer}");
            let text = number[2].as_str().unwrap();
            let fits = is_rounded(value, text);
            assert!(fits, "{page}: {pointer}: {value} is shown as {text}");
        }
        silent(&browser);
    }
}

/// The pages meet WCAG 2.2 AA in light and in dark, with box and marks. Nothing is wider than a phone, and paper shows no
/// controls.
#[test]
fn the_pages_are_legible() {
    let Some(mut browser) = Browser::start("contrast of reports") else {
        return;
    };
    let (folder, pages) = pages();
    for (page, _) in pages {
        open(&mut browser, &folder, page);
        for scheme in ["light", "dark"] {
            browser.media("screen", scheme);
            browser.evaluate(
                "document.querySelectorAll('details').forEach((one) => { one.open = true; })",
            );
            let found = browser.evaluate("tests.contrasts()");
            assert!(found["count"].as_u64().unwrap() > 100, "{page}: {found}");
            assert_eq!(found["low"], json!([]), "{page} in {scheme}");
            browser.press("Tab", 0);
            browser.evaluate("document.querySelector('svg[data-plane]').focus()");
            browser.press("End", 0);
            assert_ne!(browser.evaluate("tests.state().tip"), "", "{page}");
            let found = browser.evaluate("tests.contrasts()");
            assert_eq!(
                found["low"],
                json!([]),
                "{page} in {scheme}, with an answer"
            );
            browser.press("Escape", 0);
        }
        for width in [320, 390, 1100] {
            browser.size(width, 800);
            assert_eq!(
                browser.evaluate("tests.sideways()"),
                0,
                "{page}, {width} wide"
            );
        }
        browser.evaluate("document.querySelector('svg[data-plane]').focus()");
        browser.press("End", SHIFT);
        browser.media("print", "dark");
        let shown = browser.evaluate(
            "['.tip', '.panel', '.hint', 'nav'].filter((name) => Array.from(document.querySelectorAll(name)).some((e) => e.getClientRects().length > 0))",
        );
        assert_eq!(shown, json!([]), "{page} on paper");
        let found = browser.evaluate("tests.contrasts()");
        assert_eq!(found["low"], json!([]), "{page} on paper");
        browser.media("", "light");
        let paper = browser.call("Page.printToPDF", json!({"preferCSSPageSize": true}));
        let paper = paper["data"].as_str().unwrap();
        // The first bytes of a PDF, in base64.
        assert!(paper.starts_with("JVBERi"), "{page}");
        assert!(paper.len() > 20_000, "{page}");
        silent(&browser);
    }
}

/// Names of files, sessions and robots stay text, and even if they did not, the policy would stop their scripts.
#[test]
fn a_script_in_a_name_does_not_run() {
    let Some(mut browser) = Browser::start("hostile names in reports") else {
        return;
    };
    let folder = Folder::new();
    let hostile = "<script>alert(1)</script><img src=x onerror=alert(2)>";
    let csv = changed(&simulated("train", 60), |_, fields| {
        fields.push(format!("\"{hostile}\""))
    });
    let name = "<script>alert(3)<!--.csv";
    folder.write(name, csv.replacen('\n', ",session\n", 1));
    folder.write("robot.toml", hostile_robot());
    let line = "calibrate --robot robot.toml --method poe --out arm.blob --report report.html";
    let mut command = folder.command(line);
    command
        .arg(name)
        .args(["--serial-number", "<svg onload=alert(4)>"]);
    folder.finish(&mut command).ok();
    open(&mut browser, &folder, "report.html");
    assert_eq!(browser.evaluate("document.scripts.length"), 1);
    assert_eq!(
        browser.evaluate("document.querySelectorAll('img, script[src], iframe').length"),
        0
    );
    let text = browser.text("tests.text()");
    for part in [
        hostile,
        name,
        "<svg onload=alert(4)>",
        "</h1><svg onload=alert(5)>",
    ] {
        assert!(text.contains(part), "{part}");
    }
    // In the box as well.
    browser.press("Tab", 0);
    browser.evaluate("document.querySelector('svg[data-plane]').focus()");
    browser.press("End", 0);
    let state = browser.evaluate("tests.state()");
    assert!(state["tip"].as_str().unwrap().contains(hostile), "{state}");
    silent(&browser);
    // The policy stops every script that is not the page's own.
    let stopped = "new Promise((done) => {
        document.addEventListener('securitypolicyviolation', (event) => done(event.effectiveDirective), { once: true });
        const script = document.createElement('script');
        script.textContent = 'alert(6)';
        document.body.append(script);
    })";
    assert_eq!(browser.evaluate(stopped), "script-src-elem");
    assert!(
        browser
            .complaints
            .iter()
            .all(|one| !one.starts_with("dialog")),
        "{:?}",
        browser.complaints
    );
    assert_eq!(browser.complaints.len(), 1, "{:#?}", browser.complaints);
}

fn hostile_robot() -> String {
    let path = concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/../calibration/robots/abb-irb4400-serial.toml"
    );
    let text = std::fs::read_to_string(path).unwrap();
    text.replacen(
        "name = \"abb-irb4400-serial\"",
        "name = '</h1><svg onload=alert(5)>'",
        1,
    )
}
