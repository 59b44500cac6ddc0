//! The pictures of the guide: the report of the demonstration in light, in dark, on a phone and on paper.

use std::path::{Path, PathBuf};

use serde_json::json;

use crate::browser::chromium::Browser;
use crate::browser::open;
use crate::program::Folder;

/// Largest size of a picture, bytes.
const LARGEST: u64 = 150_000;
const PICTURES: [&str; 4] = ["light", "dark", "phone", "print"];

const PALETTE: &str = include_str!("palette.js");

fn file(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("../docs/guide/report-{name}.png"))
}

#[test]
fn pictures_of_the_guide_are_small() {
    for name in PICTURES {
        let bytes = std::fs::metadata(file(name)).unwrap().len();
        assert!((5_000..LARGEST).contains(&bytes), "{name}: {bytes}");
    }
}

/// Rewrites the pictures: `POEGP_BLESS=1 cargo test -p poegp-trainer --test cli pictures -- --include-ignored`.
#[test]
#[ignore = "takes the pictures of the guide again"]
fn take_the_pictures() {
    if std::env::var_os("POEGP_BLESS").is_none() {
        return;
    }
    let mut browser = Browser::start("pictures of the guide").unwrap();
    let folder = Folder::new();
    folder.run("demo").ok();
    for name in PICTURES {
        let (width, height) = match name {
            "phone" => (390, 844),
            "print" => (794, 1123),
            _ => (1040, 860),
        };
        browser.size(width, height);
        let medium = if name == "print" { "print" } else { "screen" };
        let scheme = if name == "dark" { "dark" } else { "light" };
        browser.media(medium, scheme);
        open(&mut browser, &folder, "demo/report.html");
        if name == "print" {
            // The margin that the style sheet has for paper.
            browser.evaluate("document.body.style.margin = '14mm'");
        }
        let (anchor, marks) = match name {
            // With a box and marked poses.
            "light" | "phone" => ("#joints", true),
            "dark" => ("#workspace", false),
            _ => ("body", false),
        };
        browser.evaluate(&format!(
            "document.querySelector('{anchor}').scrollIntoView()"
        ));
        if marks {
            let plot = "document.querySelector('#joints svg[data-plane]')";
            let place = browser.evaluate(&format!(
                "(({{ left, top, width, height }}) => [left, top, width, height])({plot}.getBoundingClientRect())"
            ));
            let place: Vec<f64> = place
                .as_array()
                .unwrap()
                .iter()
                .map(|x| x.as_f64().unwrap())
                .collect();
            let at = |x: f64, y: f64| (place[0] + x * place[2], place[1] + y * place[3]);
            browser.mouse("mouseMoved", at(0.55, 0.2));
            browser.mouse("mousePressed", at(0.55, 0.2));
            for x in [0.6, 0.7, 0.8] {
                let (x, y) = at(x, 0.3);
                browser.call(
                    "Input.dispatchMouseEvent",
                    json!({"type": "mouseMoved", "x": x, "y": y, "button": "left", "buttons": 1}),
                );
            }
            browser.mouse("mouseReleased", at(0.8, 0.3));
            let shown = "(() => { const rows = Array.from(document.querySelectorAll('#poses tbody tr'), (row) => Number(row.cells[1].textContent)); \
                const pose = rows.indexOf(Math.max(...rows)); const svg = document.querySelector('#joints svg[data-plane]'); \
                const d = Array.from(svg.querySelectorAll('path[data-poses]')).pop().getAttribute('d').split('M')[pose + 1].split('h')[0].split(' ').map(Number); \
                const box = svg.getBoundingClientRect(); const scale = box.width / svg.viewBox.baseVal.width; \
                return [box.left + scale * d[0], box.top + scale * d[1]]; })()";
            let shown = browser.evaluate(shown);
            browser.mouse(
                "mouseMoved",
                (shown[0].as_f64().unwrap(), shown[1].as_f64().unwrap()),
            );
        }
        let picture = browser.call(
            "Page.captureScreenshot",
            json!({"format": "png", "optimizeForSpeed": false}),
        );
        let data = picture["data"].as_str().unwrap();
        browser.call("Page.navigate", json!({"url": "about:blank"}));
        let expression = format!("({})('data:image/png;base64,{data}')", PALETTE.trim());
        let bytes = decoded(&browser.text(&expression));
        std::fs::write(file(name), bytes).unwrap();
    }
}

/// Decodes Base64 (RFC 4648).
fn decoded(text: &str) -> Vec<u8> {
    let digits = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let (mut out, mut bits, mut count) = (Vec::new(), 0_u32, 0);
    for digit in text.bytes().filter(|b| *b != b'=') {
        bits = bits << 6 | digits.iter().position(|d| *d == digit).unwrap() as u32;
        count += 6;
        if count >= 8 {
            count -= 8;
            out.push((bits >> count & 0xff) as u8);
        }
    }
    out
}
