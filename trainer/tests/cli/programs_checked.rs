//! `trainer check --programs`: compares the records of corrected programs with a model.

use poegp_protocol::limits::MAX_JOINTS;

use crate::program::{Folder, SERIAL, simulated};
use crate::programs::{commander, folder, numbers_after};
use crate::texts::texts;

/// A program with one target.
const ONE: &str = "MODULE One\n  PERS tooldata gun:=[TRUE,[[30,-45,210],[0.97629601,0.21643961,0,0]],[2.5,[0,0,15],[1,0,0,0],0,0,0]];\n  \
    PROC main()\n    MoveAbsJ [[12.5,20.25,-4.125,-18.5,48,31.75],[9E9,9E9,9E9,9E9,9E9,9E9]],v200,fine,gun;\n  ENDPROC\nENDMODULE\n";

/// Returns programs corrected by another model, corrected by the model of the check, and brought back; and a longer one.
fn checked() -> Folder {
    let folder = folder();
    folder.write("fresh.csv", simulated("test2", 20));
    folder.write("one.mod", ONE);
    folder
        .run(&format!(
            "calibrate --robot {SERIAL} train.csv --method poe --out old.blob"
        ))
        .ok();
    std::fs::create_dir(folder.path("out")).unwrap();
    for (blob, source, out) in [
        ("old", "one.mod", "one.mod"),
        ("elas", "one.mod", "two.mod"),
        ("old", "part.src", "part.src"),
    ] {
        let line = format!("correct {blob}.blob {source} --payload-kg 2.5 --out out/{out}");
        folder.run(&line).ok();
    }
    let back = "correct elas.blob out/two.mod --payload-kg 2.5 --inverse --out out/back.mod";
    folder.run(back).ok();
    folder
}

/// The stated move is the distance between the commands that both models write, according to the model of the check.
#[test]
fn programs_of_another_model_are_named_with_their_moves() {
    let _texts = texts();
    let folder = checked();
    folder
        .run("check elas.blob fresh.csv --max-mm 0.2 --programs out --json a.json --report a.html")
        .ok()
        .said();
    let document = folder.json("a.json");
    let programs = document["programs"].as_array().unwrap();
    let named = |name: &str| {
        let is_it = |p: &&serde_json::Value| p["program"] == format!("out/{name}");
        programs.iter().find(is_it).unwrap()
    };
    // part.src counts once more for its data list, which was corrected with it.
    assert_eq!(programs.len(), 5);
    for (name, by_this_model, is_brought_back) in [
        ("one.mod", false, false),
        ("two.mod", true, false),
        ("back.mod", true, true),
        ("part.dat", false, false),
    ] {
        let p = named(name);
        assert_eq!(p["by_this_model"], by_this_model, "{p}");
        assert_eq!(p["is_brought_back"], is_brought_back, "{p}");
        assert_eq!(p["is_unchanged"], true, "{p}");
        let has_moves = !by_this_model && !is_brought_back && p["targets"] != 0;
        assert_eq!(p.get("moves_mm").is_some(), has_moves, "{p}");
    }
    let commander = commander(&folder, "elas.blob");
    let tip = |file: &str| {
        let mut joints = [0.0; MAX_JOINTS];
        let degrees = numbers_after(&folder.read(file), "MoveAbsJ [[", 6);
        for (slot, q) in joints.iter_mut().zip(degrees) {
            *slot = q.to_radians();
        }
        let flange = commander.real_flange(&joints, 2.5);
        flange.translation + flange.rotation * nalgebra::Vector3::new(0.03, -0.045, 0.21)
    };
    let apart = 1e3 * (tip("out/one.mod") - tip("out/two.mod")).norm();
    let one = named("one.mod");
    let said = one["moves_mm"]["mean"].as_f64().unwrap();
    eprintln!("said {said} mm, the files are {apart} mm apart");
    assert!(
        apart > 0.02 && (said - apart).abs() < 2e-4,
        "{said} {apart}"
    );
    assert_eq!((&one["targets"], &one["compared"]), (&1.into(), &1.into()));
    assert!(folder.text("a.html").contains("Corrected programs"));

    // A file that somebody changed, and one that is missing.
    folder.write("out/one.mod", "MODULE One\nENDMODULE\n");
    std::fs::remove_file(folder.path("out/two.mod")).unwrap();
    folder
        .run("check elas.blob fresh.csv --max-mm 0.2 --programs out/one.mod --programs out/two.mod.poegp.json")
        .ok()
        .said();
}

#[test]
fn what_has_no_record_or_is_an_output_is_refused() {
    let _texts = texts();
    let folder = checked();
    std::fs::create_dir(folder.path("empty")).unwrap();
    folder.write("spoilt.mod.poegp.json", "{\"version\": 3}");
    let record = folder.text("out/one.mod.poegp.json");
    folder.write("ur.mod.poegp.json", record.replace(SERIAL, "ur10"));
    for path in ["one.mod", "empty", "missing", "spoilt.mod", "ur.mod"] {
        folder.refuses(format!(
            "check elas.blob fresh.csv --max-mm 0.2 --programs {path}"
        ));
    }
    for output in ["one.mod", "two.mod.poegp.json"] {
        folder.refuses(format!(
            "check elas.blob fresh.csv --max-mm 0.2 --programs out --json out/{output}"
        ));
    }
}
