//! Checks that the committed `include/poegp.h` is what cbindgen generates from the sources, including the comments.
//!
//! `POEGP_BLESS=1 cargo test -p poegp-capi --test header` regenerates the header.

use std::path::Path;
use std::{env, fs};

use cbindgen::{Builder, Config, DocumentationStyle, Language, LineEndingStyle, Style};

const HEAD: &str = "\
/* Calibrated robot arms for programs in C. README.md in the parent folder explains how to link and use the library.

   Generated from the Rust sources; do not edit (see tests/header.rs). Units are radians, metres and kilograms. The
   library checks every pointer as far as it can and refuses those that are null, misaligned or overlapping. It
   cannot check that a pointer leads to as much memory as stated: the caller must guarantee this (# Safety). */";

#[test]
fn the_committed_header_is_the_generated_one() {
    let package = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut config = Config {
        language: Language::C,
        cpp_compat: true,
        include_guard: Some("POEGP_H".to_owned()),
        header: Some(HEAD.to_owned()),
        no_includes: true,
        sys_includes: vec!["stddef.h".to_owned(), "stdint.h".to_owned()],
        style: Style::Both,
        usize_is_size_t: true,
        documentation_style: DocumentationStyle::C,
        line_endings: LineEndingStyle::LF,
        line_length: 110,
        ..Config::default()
    };
    // Generic structures are written once for each number type.
    for (rust, c) in [
        ("Model", "model"),
        ("Filter", "filter"),
        ("Evaluation", "evaluation"),
        ("Corrected", "corrected"),
        ("Forward", "forward"),
        ("Inverse", "inverse"),
        ("Jacobian", "jacobian"),
        ("FilterSettings", "filter_settings"),
        ("Commanded", "commanded"),
    ] {
        let rename = &mut config.export.rename;
        rename.insert(format!("{rust}_f32"), format!("poegp_{c}_t"));
        rename.insert(format!("{rust}_f64"), format!("poegp_{c}_f64_t"));
    }
    for (rust, c) in [
        ("Identity", "poegp_identity_t"),
        ("FilterCounts", "poegp_filter_counts_t"),
        ("CyclicAnswer", "poegp_cyclic_answer_t"),
    ] {
        config.export.rename.insert(rust.to_owned(), c.to_owned());
    }
    let sources = [
        "types.rs",
        "codes.rs",
        "ffi.rs",
        "filter.rs",
        "cyclic.rs",
        "double.rs",
    ];
    let builder = sources
        .iter()
        .fold(Builder::new().with_config(config), |builder, source| {
            builder.with_src(package.join("src").join(source))
        });
    let mut generated = Vec::new();
    builder.generate().unwrap().write(&mut generated);
    let generated = String::from_utf8(generated).unwrap();
    let path = package.join("include/poegp.h");
    if env::var_os("POEGP_BLESS").is_some() {
        fs::write(&path, &generated).unwrap();
    }
    let committed = fs::read_to_string(&path).unwrap();
    for (number, (found, expected)) in committed.lines().zip(generated.lines()).enumerate() {
        assert_eq!(
            found,
            expected,
            "poegp.h, line {}: see the top of tests/header.rs",
            number + 1
        );
    }
    assert!(committed == generated, "poegp.h has another length");
    for function in ["poegp_evaluate", "poegp_command", "poegp_inverse_f64"] {
        assert!(
            generated.contains(&format!("int32_t {function}(")),
            "{generated}"
        );
    }
}
