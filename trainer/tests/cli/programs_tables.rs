//! `trainer correct` of tables of poses: columns that are written in another way, and columns that nothing reads.

use crate::program::{Folder, Outcome};
use crate::programs::{folder, numbers_after};
use crate::texts::texts;

const HEADER: &str = "x_mm,y_mm,z_mm,qw,qx,qy,qz";
const ROW: &str = "1250,-180,1320,0.1830127,0.6830127,-0.1830127,0.6830127";
/// Joints near the row's.
const SEEDS: &str = "seed_q1_deg,seed_q2_deg,seed_q3_deg,seed_q4_deg,seed_q5_deg,seed_q6_deg";
const SEED: &str = "8,22,1,-14,46,24";
const FRAMES: &str = "[tool.gun]\nxyz_mm = [30, -45, 210]\nquaternion = [1, 0, 0, 0]\npayload_kg = 1\n\
                      [base.\"2\"]\nxyz_mm = [10, 20, 30]\nquaternion = [1, 0, 0, 0]\n";

fn correct(folder: &Folder, header: &str, row: &str, more: &str) -> Outcome {
    folder.write("f.toml", FRAMES);
    folder.write("t.csv", format!("{header},{SEEDS}\n{row},{SEED}\n"));
    folder.run(&format!("correct elas.blob t.csv --out o.csv {more}"))
}

/// The position of the only row.
fn position(folder: &Folder) -> Vec<f64> {
    numbers_after(&folder.read("o.csv"), "\n", 3)
}

#[test]
fn upper_case_names_are_the_same_columns() {
    let folder = folder();
    let all = "--payload-kg 2.5 --frames f.toml";
    let (header, row) = (format!("{HEADER},tool,base"), format!("{ROW},gun,2"));
    correct(&folder, &header, &row, all).ok();
    let lower = position(&folder);
    for header in [header.to_ascii_uppercase(), format!("{HEADER},Tool,Base")] {
        let said = correct(&folder, &header, &row, all).ok();
        assert!(
            said.stdout.contains("Tool gun: from f.toml"),
            "{}",
            said.stdout
        );
        assert_eq!(position(&folder), lower, "{header}");
    }
    correct(&folder, HEADER, ROW, all).ok();
    assert_ne!(position(&folder), lower);
}

/// The fields are names of the file of frames, so that the row is not of the flange.
#[test]
fn a_column_of_tools_with_another_name_is_refused() {
    let _texts = texts();
    let folder = folder();
    for (name, field, expected) in [
        ("tool_name", "gun", "column tool with the names gun"),
        ("UTOOL", "GUN", "column tool with the names gun"),
        ("what", "gun", "column tool with the names gun"),
        ("wobj", "2", "column base with the names 2"),
        ("Frame", "2", "column base with the names 2"),
    ] {
        let (header, row) = (format!("{HEADER},{name}"), format!("{ROW},{field}"));
        let said = correct(&folder, &header, &row, "--payload-kg 2.5 --frames f.toml").refused();
        for text in [format!("t.csv:1: column 8 ({name})"), expected.to_owned()] {
            assert!(said.stderr.contains(&text), "{}", said.stderr);
        }
    }
}

#[test]
fn columns_and_frames_that_nothing_reads_are_said() {
    let folder = folder();
    let (header, row) = (format!("{HEADER},tool_name"), format!("{ROW},torch"));
    let said = correct(&folder, &header, &row, "--payload-kg 2.5 --frames f.toml").ok();
    for text in [
        "note: the column tool_name is not read: the tool of a row is in a column tool",
        "note: no row names the tool gun of f.toml",
        "note: no row names the base 2 of f.toml",
    ] {
        assert!(said.stdout.contains(text), "{}", said.stdout);
    }
    // A description beside the tool, and a number that is the name of a base by chance.
    let header = format!("{HEADER},tool,tool_note,part");
    let row = format!("{ROW},gun,old,2");
    let said = correct(&folder, &header, &row, "--payload-kg 2.5 --frames f.toml").ok();
    assert!(!said.stdout.contains("is not read"), "{}", said.stdout);
    assert!(!said.stdout.contains("the tool gun"), "{}", said.stdout);
}

#[test]
fn a_second_column_of_one_name_is_refused() {
    let _texts = texts();
    let folder = folder();
    for name in ["x_mm", "X_mm", "qz"] {
        let (header, row) = (format!("{HEADER},{name}"), format!("{ROW},7"));
        let said = correct(&folder, &header, &row, "--payload-kg 2.5").refused();
        let text = format!("t.csv:1: column 8 ({name}): found a second column {name}");
        assert!(said.stderr.contains(&text), "{}", said.stderr);
    }
    // Columns that nothing reads may have one name.
    let (header, row) = (format!("{HEADER},note,note"), format!("{ROW},a,b"));
    correct(&folder, &header, &row, "--payload-kg 2.5").ok();
}

#[test]
fn payloads_of_two_places_are_refused() {
    let _texts = texts();
    let folder = folder();
    let (header, row) = (format!("{HEADER},Payload_kg"), format!("{ROW},2"));
    let said = correct(&folder, &header, &row, "--payload-kg 2.5").refused();
    let text = "found --payload-kg and the column payload_kg of t.csv, expected one of them";
    assert!(said.stderr.contains(text), "{}", said.stderr);
    correct(&folder, &header, &row, "--payload-from-program").ok();
    // Those of the frames are no part of the table.
    let (header, row) = (format!("{HEADER},tool"), format!("{ROW},gun"));
    let said = correct(&folder, &header, &row, "--payload-kg 2.5 --frames f.toml").ok();
    let text = "note: payload_kg of the file of --frames is not used";
    assert!(said.stdout.contains(text), "{}", said.stdout);
}

/// Nothing states the branch of a row without seeds, and its solutions need corrections of their own. In a table with seeds, a
/// row without them is on the branch of the row before.
#[test]
fn a_row_whose_branch_nothing_states_stays() {
    let _texts = texts();
    let folder = folder();
    let near = "1260,-180,1320,0.1830127,0.6830127,-0.1830127,0.6830127";
    let table = |rows: &str| folder.write("t.csv", rows).to_owned();
    let line = "correct elas.blob t.csv --out o.csv --payload-kg 2.5";
    table(&format!("{HEADER}\n{ROW}\n{near}\n"));
    folder.refuses(line);
    let with_seeds = |first: &str, second: &str| {
        table(&format!(
            "{HEADER},{SEEDS}\n{ROW},{first}\n{near},{second}\n"
        ));
    };
    with_seeds(SEED, SEED);
    folder.run(line).ok();
    let both = folder.text("o.csv");
    with_seeds(SEED, ",,,,,");
    folder.run(line).ok();
    let place = |text: &str| -> Vec<String> {
        let rows = text.lines().skip(1);
        rows.map(|row| row.split(',').take(7).collect::<Vec<_>>().join(","))
            .collect()
    };
    assert_eq!(place(&folder.text("o.csv")), place(&both));
    with_seeds(",,,,,", SEED);
    folder.refuses(line);
    with_seeds(SEED, ",,,,,24");
    folder.refuses(line);
}

/// The joints are the targets, and the poses beside them are now those of other joints.
#[test]
fn poses_beside_joints_are_said_to_stay() {
    let folder = folder();
    let header = format!("q1_deg,q2_deg,q3_deg,q4_deg,q5_deg,q6_deg,{HEADER}");
    let row = format!("8,22,1,-14,46,24,{ROW}");
    let said = correct(&folder, &header, &row, "--payload-kg 2.5").ok();
    let text =
        "only the joints are corrected, and x_mm, y_mm, z_mm, qw, qx, qy, qz stay as they are";
    assert!(said.stderr.contains(text), "{}{}", said.stdout, said.stderr);
    assert!(folder.text("o.csv").contains(ROW));
}
