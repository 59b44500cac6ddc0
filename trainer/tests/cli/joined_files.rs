//! Poses in one file and joints in another: joined by order, by an index or by time.

use crate::foreign_files::{POSES, assert_simulated, folder, import, table};
use crate::import::rows;
use crate::program;
use crate::program::{Folder, simulated};
use crate::texts::texts;

/// Returns a map of the tracker's poses and of joints, with these keys.
fn joined(joints: &str) -> String {
    format!(
        "file = {{ separator = \"semicolon\" }}\nposition = {{ columns = [\"X\", \"Y\", \"Z\"] }}\n\
         orientation = {{ kind = \"rotation-vector\", columns = [\"RX\", \"RY\", \"RZ\"] }}\n{joints}"
    )
}

const BY_TIME: &str = r#"
joints_file = { separator = "space" }
joints = { driver = "ur-rtde" }
payload = { column = "payload", unit = "kg" }
join = { by = "time", poses = "Time", joints = "timestamp", joints_unit = "s", tolerance_s = 0.004 }
"#;
const BY_INDEX: &str = r#"
joints_file = { separator = "tab" }
joints = { driver = "abb" }
payload = { column = "loaddata.mass", unit = "kg" }
join = { by = "index", poses = "No", joints = "No" }
"#;

fn by_order(driver: &str, separator: &str, payload: &str) -> String {
    joined(&format!(
        "joints_file = {{ separator = \"{separator}\" }}\njoints = {{ driver = \"{driver}\" }}\n\
         payload = {{ column = \"{payload}\", unit = \"kg\" }}\njoin = {{ by = \"order\" }}\n"
    ))
}

#[test]
fn joints_of_drivers_are_joined_to_poses_by_order_index_and_time() {
    for (file, map) in [
        ("ros.csv", by_order("ur", "comma", "payload")),
        ("fanuc.csv", by_order("fanuc", "comma", "PAYLOAD")),
        ("kuka.csv", by_order("kuka", "semicolon", "LOAD")),
        ("abb.txt", joined(BY_INDEX)),
        ("rtde.txt", joined(BY_TIME)),
    ] {
        let folder = folder(&["tracker.csv", file]);
        import(&folder, &format!("tracker.csv {file}"), &map).ok();
        assert_simulated(&folder);
    }
}

/// Joint names of other drivers, in radians, each with the same joints.
#[test]
fn names_of_other_drivers_are_their_joints() {
    let motoman = "joint_1_s,joint_2_l,joint_3_u,joint_4_r,joint_5_b,joint_6_t".to_owned();
    let numbered = |name: &str| {
        let names: Vec<String> = (1..=6).map(|i| format!("{name}{i}")).collect();
        names.join(",")
    };
    for (driver, names) in [
        ("motoman", motoman),
        ("panda", numbered("panda_joint")),
        ("fr3", numbered("fr3_joint")),
    ] {
        let folder = folder(&["tracker.csv", "ros.csv"]);
        let text = folder.text("ros.csv");
        let (_, rows) = text.split_once('\n').unwrap();
        folder.write("ros.csv", format!("{names},payload\n{rows}"));
        let map = by_order(driver, "comma", "payload");
        import(&folder, "tracker.csv ros.csv", &map).ok();
        assert_simulated(&folder);
    }
}

/// Returns the tracker's times, 2.5 s apart from 1 000 s after its clock began, written as dates and times.
fn dated(
    folder: &Folder,
    file: &str,
    column: usize,
    separator: char,
    date: impl Fn(f64) -> String,
) {
    let text = folder.text(file);
    let mut lines = text.lines();
    let mut out = lines.next().unwrap().replace(" [ms]", "") + "\n";
    for line in lines {
        let mut fields: Vec<String> = line.split(separator).map(str::to_owned).collect();
        fields[column] = date(fields[column].parse::<f64>().unwrap());
        out += &(fields.join(&separator.to_string()) + "\n");
    }
    folder.write(file, out);
}

/// Starts 5 seconds before midnight, so that hours, days and months change.
fn clock(seconds: f64, zone: &str, hours: i64) -> String {
    let whole = seconds.floor() as i64 - 1000 + 23 * 3600 + 59 * 60 + 55 + 3600 * hours;
    let (day, time) = (28 + whole.div_euclid(86_400), whole.rem_euclid(86_400));
    let (month, day) = if day > 28 { (3, day - 28) } else { (2, day) };
    let (h, m, s) = (time / 3600, time / 60 % 60, time % 60);
    let micros = ((seconds - seconds.floor()) * 1e6).round();
    format!("2026-{month:02}-{day:02}T{h:02}:{m:02}:{s:02}.{micros:06}{zone}")
}

#[test]
fn dates_and_times_of_two_zones_are_joined() {
    let by_time = |poses: &str, joints: &str| {
        let keys = BY_TIME.replace(
            "joints_unit = \"s\"",
            &format!("joints_unit = \"{joints}\""),
        );
        joined(&keys.replace("poses = ", &format!("poses_unit = \"{poses}\", poses = ")))
    };
    let iso = by_time("iso8601", "iso8601");
    let mut local = Vec::new();
    for zones in [["Z", "+02:00"], ["", ""]] {
        let folder = folder(&["tracker.csv", "rtde.txt"]);
        let hours = if zones[0].is_empty() { 0 } else { 2 };
        dated(&folder, "tracker.csv", 1, ';', |ms| {
            let text = clock(ms / 1000.0, zones[0], 0);
            text.replace('T', " ")
        });
        dated(&folder, "rtde.txt", 0, ' ', |s| clock(s, zones[1], hours));
        import(&folder, "tracker.csv rtde.txt", &iso).ok();
        assert_simulated(&folder);
        local.push(folder);
    }
    // ROS stamps messages in nanoseconds.
    for (unit, digits) in [("ns", "000000"), ("us", "000")] {
        let folder = folder(&["tracker.csv", "rtde.txt"]);
        dated(&folder, "tracker.csv", 1, ';', |ms| format!("{ms}{digits}"));
        import(&folder, "tracker.csv rtde.txt", &by_time(unit, "s")).ok();
        assert_simulated(&folder);
    }
    let _texts = texts();
    // A time zone in only one file, a number, and an invalid date.
    let [zoned, local] = &local[..] else {
        unreachable!()
    };
    let refused =
        |folder: &Folder, map: &str| import(folder, "tracker.csv rtde.txt", map).refused();
    zoned.write("rtde.txt", local.text("rtde.txt"));
    refused(zoned, &iso);
    refused(local, &by_time("iso8601", "s"));
    refused(local, &by_time("ms", "iso8601"));
    let text = local.text("tracker.csv");
    local.write(
        "tracker.csv",
        text.replace("2026-02-28 23:59:55", "2026-02-31 23:59:55"),
    );
    refused(local, &iso);
}

/// Whichever rows are missing, an imported row has the joints of its own pose, or the import is refused.
#[test]
fn no_pose_gets_the_joints_of_another() {
    let files = folder(&["tracker.csv", "abb.txt", "rtde.txt"]);
    let without = |file: &str, gone: &[usize]| -> String {
        let text = files.text(file);
        let kept = text.lines().enumerate().filter(|(i, _)| !gone.contains(i));
        kept.map(|(_, line)| format!("{line}\n")).collect()
    };
    for gone in 1..=POSES {
        for (file, keys) in [("abb.txt", BY_INDEX), ("rtde.txt", BY_TIME)] {
            let folder = folder(&["tracker.csv", file]);
            // The log has seven rows for each pose; the fourth is at the pose.
            let row = if keys == BY_TIME { 7 * gone - 3 } else { gone };
            folder.write(file, without(file, &[row]));
            let map = joined(keys);
            let line = format!("tracker.csv {file}");
            let outcome = import(&folder, &line, &map);
            assert_eq!(outcome.code, Some(2), "{outcome:#?}");
            import(
                &folder,
                &line,
                &format!("incomplete = \"leave-out\"\n{map}"),
            )
            .ok();
            let text = program::without(&rows(&folder.text("data.csv")), &["time_s"]);
            let (_, imported) = table(&text);
            let (_, expected) = table(&simulated("train", POSES));
            assert_eq!(imported.len(), POSES - 1);
            for row in imported {
                let same = |wanted: &&Vec<f64>| (wanted[7] - row[7]).abs() < 1e-5;
                let wanted = expected.iter().find(same).unwrap();
                let apart = row[1..7]
                    .iter()
                    .zip(&wanted[1..7])
                    .map(|(a, b)| (a - b).abs());
                assert!(apart.fold(0.0, f64::max) < 1e-8, "{row:?} {wanted:?}");
            }
        }
    }
}

#[test]
fn joins_that_are_not_unique_are_refused_with_their_lines() {
    let _texts = texts();
    let refused = |file: &str, map: &str, change: &dyn Fn(&Folder)| {
        let folder = folder(&["tracker.csv", file]);
        change(&folder);
        import(&folder, &format!("tracker.csv {file}"), map).refused();
    };
    let same = |_: &Folder| {};
    let last_line = |file: &'static str, line: &'static str| {
        move |folder: &Folder| {
            let text = folder.text(file);
            let kept = text.trim_end().rsplit_once('\n').unwrap().0;
            folder.write(file, format!("{kept}\n{line}"));
        }
    };
    let time = |keys: &str| joined(&BY_TIME.replace("tolerance_s = 0.004", keys));
    refused("rtde.txt", &time("tolerance_s = 0.02"), &same);
    refused("rtde.txt", &time("tolerance_s = 0.001"), &same);
    refused("rtde.txt", &time("tolerance_s = 0"), &same);
    refused(
        "rtde.txt",
        &time("poses_unit = \"s\", tolerance_s = 0.004"),
        &same,
    );
    refused(
        "rtde.txt",
        &joined(&BY_TIME.replace(", tolerance_s = 0.004", "")),
        &same,
    );
    refused(
        "rtde.txt",
        &joined(&BY_TIME.replace("joints_unit = \"s\", ", "")),
        &same,
    );
    refused(
        "rtde.txt",
        &joined(BY_TIME),
        &last_line("tracker.csv", "008;1015000;1;2;3;4;5;6\n"),
    );
    refused(
        "abb.txt",
        &joined(BY_INDEX),
        &last_line("abb.txt", "002\t1\t2\t3\t4\t5\t6\t0\n"),
    );
    refused(
        "abb.txt",
        &joined(BY_INDEX),
        &last_line("abb.txt", "009\t1\t2\t3\t4\t5\t6\t0\n"),
    );
    refused("abb.txt", &joined(BY_INDEX), &last_line("tracker.csv", ""));
    refused(
        "abb.txt",
        &joined(BY_INDEX),
        &last_line("tracker.csv", "007;0;1;2;3;4;5;6\n"),
    );
    refused(
        "abb.txt",
        &joined(&BY_INDEX.replace(", joints = \"No\"", "")),
        &same,
    );
    refused(
        "ros.csv",
        &by_order("ur", "comma", "payload"),
        &last_line("ros.csv", ""),
    );
    refused(
        "ros.csv",
        &by_order("ur", "comma", "payload"),
        &last_line("tracker.csv", ""),
    );
    refused("ros.csv", &by_order("kuka", "comma", "payload"), &same);
    refused("ros.csv", &by_order("robot", "comma", "payload"), &same);
    let with = |keys: &str| by_order("ur", "comma", "payload").replace("\"ur\"", keys);
    refused("ros.csv", &with("\"ur\", unit = \"deg\""), &same);
    refused("ros.csv", &with("\"ur\", columns = [1]"), &same);
    let folder = folder(&["tracker.csv"]);
    import(&folder, "tracker.csv", &by_order("ur", "comma", "payload")).refused();
}
