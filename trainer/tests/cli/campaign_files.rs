//! Several files of one campaign: their rows follow each other.

use crate::import::rows;
use crate::program::{Folder, SERIAL, simulated};
use crate::texts::texts;

/// Returns a folder with a simulated set, whole and in three files.
fn folder() -> Folder {
    let folder = Folder::new();
    let whole = simulated("train", 300);
    let lines: Vec<&str> = whole.lines().collect();
    let (header, measured) = (lines[0], &lines[1..]);
    for (name, part) in ["mon.csv", "tue.csv", "wed.csv"]
        .iter()
        .zip(measured.chunks(100))
    {
        folder.write(name, format!("{header}\n{}\n", part.join("\n")));
    }
    folder.write("whole.csv", &whole);
    folder
}

/// The rows are those of one file with all of them.
#[test]
fn files_of_one_campaign_are_one_file() {
    let folder = folder();
    let whole = folder.run("import whole.csv --out of_whole.csv").ok();
    let lines = "lines of the measurement file: ";
    assert!(!whole.stderr.contains(lines), "{whole:#?}");
    let said = folder
        .run("import mon.csv tue.csv wed.csv --out all.csv")
        .ok();
    let (all, of_whole) = (folder.text("all.csv"), folder.text("of_whole.csv"));
    assert_eq!(rows(&all), rows(&of_whole));
    // The lines that are stated are those of the rows.
    let stated = format!("{lines}3–102 from mon.csv, 103–202 from tue.csv, 203–302 from wed.csv");
    assert!(said.stderr.contains(&stated), "{said:#?}");
    folder.run("import tue.csv --out tue_alone.csv").ok();
    let of_tuesday: Vec<&str> = all.lines().skip(102).take(100).collect();
    assert_eq!(
        rows(&folder.text("tue_alone.csv"))
            .lines()
            .skip(1)
            .collect::<Vec<_>>(),
        of_tuesday
    );
}

/// A session for each file is a mounting of the target for each.
#[test]
fn each_file_is_a_session_if_asked() {
    let folder = folder();
    folder
        .run("import mon.csv tue.csv --session-per-file --out all.csv")
        .ok();
    let all = rows(&folder.text("all.csv"));
    let sessions: Vec<&str> = all
        .lines()
        .skip(1)
        .map(|row| row.split(',').next().unwrap())
        .collect();
    assert!(
        sessions[..100].iter().all(|s| *s == "mon") && sessions[100..].iter().all(|s| *s == "tue")
    );
    let fitted = "calibrate --method parametric --out arm.blob all.csv --robot";
    folder.run(&format!("{fitted} {SERIAL}")).ok();
    let held = folder.run("inspect arm.blob --json -").ok().stdout;
    assert!(held.contains("\"session\": \"tue\""), "{held}");
}

/// What does not belong together is not joined.
#[test]
fn files_that_do_not_belong_together_are_refused() {
    let _texts = texts();
    let folder = Folder::new();
    let header = "time_s,q1_deg,q2_deg,x_mm,y_mm,z_mm\n";
    folder.write("mon.csv", format!("{header}0,1,2,3,4,5\n60,2,3,4,5,7\n"));
    folder.write("again.csv", format!("{header}0,1,2,3,4,5\n60,2,3,4,5,7\n"));
    folder.write("tue.csv", format!("{header}59,3,4,3,4,6\n120,2,7,4,5,7\n"));
    folder.write("bad.csv", format!("{header}100,3,4,3,4,6\n120,2,7,4,x,7\n"));
    folder.write(
        "more.csv",
        "time_s,payload_kg,q1_deg,q2_deg,x_mm,y_mm,z_mm\n61,1,3,4,3,4,6\n",
    );
    folder.write(
        "named.csv",
        "session,q1_deg,q2_deg,x_mm,y_mm,z_mm\nday,3,4,3,4,6\n",
    );
    folder.write("joints.csv", "q1_deg,q2_deg\n1,2\n");
    folder.write("kuka.csv", "A1,A2,X,Y,Z,A,B,C\n1,2,3,4,5,0,0,0\n");
    std::fs::create_dir(folder.path("later")).unwrap();
    folder.write(
        "later/mon.csv",
        format!("{header}60,1,5,3,4,5\n90,2,3,5,5,7\n"),
    );
    for line in [
        "import mon.csv again.csv --out all.csv",
        "import mon.csv tue.csv --out all.csv",
        "import mon.csv bad.csv --out all.csv",
        "import mon.csv more.csv --preset poegp --out all.csv",
        "import named.csv --session-per-file --out all.csv",
        "import more.csv mon.csv --preset poegp --out all.csv",
        "import mon.csv joints.csv --out all.csv",
        "import mon.csv kuka.csv --out all.csv",
        "import mon.csv later/mon.csv --session-per-file --out all.csv",
    ] {
        folder.refuses(line);
        assert!(!folder.path("all.csv").exists(), "{line}");
    }
}
