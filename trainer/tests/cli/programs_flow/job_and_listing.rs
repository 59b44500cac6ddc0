//! Fanuc listings and INFORM jobs: remarks, frames, offsets and shifts.

use super::{check_whole, run};
use crate::programs::{file, folder};

/// Apostrophes and brackets in remarks and names do not begin a string or an argument.
#[test]
fn remarks_of_a_listing_hide_no_instruction() {
    let folder = folder();
    let text = String::from_utf8_lossy(&file("part.ls")).into_owned();
    let plain = run(&folder, "a.ls", &text, "");
    assert_eq!(plain.1, "");
    for remark in [
        "! spindle (see sheet ;",
        "! don't stop ;",
        "MESSAGE[it's (on] ;",
        "R[1:don't (]=1 ;",
        "//L P[2:it's] 5mm/sec FINE ;",
    ] {
        let text = text.replace("   4:J", &format!("   4:  {remark}\n   4:J"));
        assert_eq!(run(&folder, "b.ls", &text, ""), plain, "{remark}");
    }
    for (line, corrected, reason) in [
        ("UFRAME[2]=PR[1]", 2, "its frame or tool is set at b.ls:"),
        (
            "$MNUFRAME[1,2]=PR[5]",
            2,
            "its frame or tool is set at b.ls:",
        ),
        (
            "$MNUTOOL[1,R[2]]=PR[5]",
            2,
            "its frame or tool is set at b.ls:",
        ),
        ("$MNUFRAME[1,7]=PR[5]", 5, ""),
        ("$MNUFRAME[2,2]=PR[5]", 5, ""),
        ("P[2]=LPOS", 4, "the program changes it"),
        ("P[R[1]]=PR[3]", 0, "the program changes it"),
        // Ends that are no positions, and splines.
        (
            "L PAL_1[BTM] 100mm/sec FINE",
            5,
            "its end PAL_1 is not P[n]",
        ),
        ("S P[2] 100mm/sec FINE", 5, "a spline move is not corrected"),
        // Frames in use that are not those of the positions.
        (
            "UFRAME_NUM=5",
            2,
            "UFRAME_NUM is 5 at the motion to it, and it was taught in UF 2",
        ),
        (
            "UTOOL_NUM[GP1]=4",
            2,
            "UTOOL_NUM is 4 at the motion to it, and it was taught in UT 3",
        ),
        (
            "$MNUFRAMENUM[1]=5",
            2,
            "UFRAME_NUM is 5 at the motion to it",
        ),
        ("UFRAME_NUM=R[1]", 2, "UFRAME_NUM: it is changed at b.ls:"),
        (
            "IF (R[1]=1),UFRAME_NUM=5",
            2,
            "not on every path to this move",
        ),
        ("IF (R[1]=1) THEN ;\n UFRAME_NUM=2 ;\n ENDIF", 5, ""),
        (
            "IF (R[1]=1) THEN ;\n UFRAME_NUM=5 ;\n ENDIF",
            2,
            "not on every path to this move",
        ),
        ("JMP LBL[1] ;\n UFRAME_NUM=5 ;\n LBL[1]", 5, ""),
        (
            "IF R[1]=1,JMP LBL[1] ;\n UFRAME_NUM=5 ;\n LBL[1]",
            2,
            "not on every path",
        ),
        (
            "JMP LBL[R[1]] ;\n UFRAME_NUM=5 ;\n LBL[1]",
            2,
            "not on every path",
        ),
        ("UFRAME_NUM=5 ;\n UFRAME_NUM=2", 5, ""),
        // In whatever language of the controller.
        ("L P[2] 5mm/sec FINE VERSATZ,PR[1]", 5, "changes its end"),
        ("L P[2] 5mm/sec FINE Skip,LBL[1],PR[3]=LPOS", 5, ""),
    ] {
        let text = text.replace("   4:J", &format!("   4:  {line} ;\n   4:J"));
        check_whole(&folder, "b.ls", &text, corrected, reason);
    }
}

/// The positions of a listing that tracks a conveyor are in a frame that moves.
#[test]
fn positions_on_a_conveyor_are_left() {
    let folder = folder();
    let text = String::from_utf8_lossy(&file("part.ls")).replace("\r\n", "\n");
    let with = |schedule: u32| {
        let header = format!(
            "/APPL\n  LINE_TRACK;\nLINE_TRACK_SCHEDULE_NUMBER      : {schedule} ;\n\
             LINE_TRACK_BOUNDARY_NUMBER      : 0 ;\n/MN"
        );
        text.replace("/MN", &header)
    };
    check_whole(&folder, "b.ls", &with(0), 5, "");
    folder.write("b.ls", with(1));
    let command = "correct elas.blob b.ls --payload-kg 2.5 --frames frames.toml --out out.ls";
    let outcome = folder.run(command);
    assert_eq!(outcome.code, Some(1), "{outcome:#?}");
    let said = outcome.stdout + &outcome.stderr;
    let reason = "the listing follows a conveyor (LINE_TRACK_SCHEDULE_NUMBER 1)";
    assert!(said.contains(reason), "{said}");
    assert!(folder.read("out.ls") == with(1).into_bytes());
}

/// Motions that a sensor shifts do not end at their positions.
#[test]
fn motions_under_a_sensor_are_left() {
    let folder = folder();
    let text = String::from_utf8_lossy(&file("part.ls")).replace("\r\n", "\n");
    let text = text.replace("   4:J", "   4:  A ;\n   4:J");
    let (before, behind) = text.split_once("   4:  A ;\n").unwrap();
    let last = |line: &str| behind.replace("/POS", &format!("   9:  {line} ;\n/POS"));
    let at = |first: &str| format!("{before}   4:  {first} ;\n{behind}");
    let plain = format!("{before}{behind}");
    let all = run(&folder, "a.ls", &plain, "").0;
    for (text, reason) in [
        (at("Touch Offset PR[1]"), "Touch Offset at b.ls:"),
        (at("Track TAST[1]"), "Track at b.ls:"),
        (at("TRACK AVC[1]"), "Track at b.ls:"),
        (at("MP Offset PR[1] RPM[1]"), "MP Offset at b.ls:"),
        // A jump goes round what ends it.
        (
            at("LBL[1] ;\n   4:  Touch Offset PR[1] ;\n   4:  Touch Offset End"),
            "Touch Offset at b.ls:",
        ),
        (
            at("L P[2] 5mm/sec FINE Search[-X]"),
            "Search changes its end",
        ),
    ] {
        let (corrected, left) = run(&folder, "b.ls", &text, "");
        assert!(left.contains(reason), "{text}\n{left}");
        assert!(corrected < all || reason.starts_with("Search"), "{text}");
    }
    for text in [
        at("Touch Offset PR[1] ;\n   4:  Touch Offset End"),
        format!("{before}{}", last("Touch Offset PR[1]")),
    ] {
        assert_eq!(run(&folder, "b.ls", &text, ""), (all, String::new()));
    }
}

/// A payload that the listing sets between its motions is not that of the tool in the frame file.
#[test]
fn payloads_of_a_listing_are_not_guessed() {
    let folder = folder();
    let text = String::from_utf8_lossy(&file("part.ls")).replace("\r\n", "\n");
    let plain = run(&folder, "a.ls", &text, "--payload-from-program");
    assert_eq!(plain, (5, String::new()));
    let at = |line: &str, put: &str| text.replace(line, &format!("   1:  {put} ;\n{line}"));
    let first = at("   1:", "PAYLOAD[1]");
    assert_eq!(
        run(&folder, "b.ls", &first, "--payload-from-program"),
        plain
    );
    for text in [
        at("   5:", "PAYLOAD[1]"),
        first.replace("   5:", "   5:  PAYLOAD[2] ;\n   5:"),
        at("   1:", "PAYLOAD[R[1]]"),
    ] {
        folder.write("b.ls", &text);
        let command = "correct elas.blob b.ls --frames frames.toml --out out.ls";
        let outcome = folder.run(&format!("{command} --payload-from-program"));
        assert_ne!(outcome.code, Some(0), "{outcome:#?}");
        let said = outcome.stdout + &outcome.stderr;
        assert!(
            said.contains("the payload at this move cannot be determined from the program"),
            "{said}"
        );
        folder.run(&format!("{command} --payload-kg 2.5")).ok();
    }
}

/// A configuration that the reader does not understand, or that the joints do not have, is that of one target: it is named
/// with its line, and all others are corrected.
#[test]
fn a_configuration_without_a_meaning_is_named() {
    let folder = folder();
    let text = String::from_utf8_lossy(&file("part.ls")).replace("\r\n", "\n");
    let (all, good) = (run(&folder, "a.ls", &text, "").0, "'N U T, 0, 0, 0'");
    let from = text.find("P[4]{").unwrap();
    let line = 1 + text[..from].matches('\n').count();
    let with = |stated: &str| {
        let changed = text[from..].replacen(good, stated, 1);
        format!("{}{changed}", &text[..from])
    };
    for stated in [
        "''",
        "', 0, 0, 0'",
        "'NUT 000'",
        "'NUT, 0, 0, 0'",
        "'Ñ Ü T, 0, 0, 0'",
        "'N U T, 0, x, 0'",
        "'N U T, 0, 0.5, 0'",
    ] {
        let (corrected, left) = run(&folder, "b.ls", &with(stated), "");
        assert_eq!(corrected, all - 1, "{stated}: {left}");
        let named = left.contains("its configuration") && left.contains("is not one such as");
        assert!(
            named && left.contains(&format!("\"line\":{line}")),
            "{stated}: {left}"
        );
    }
    let (corrected, left) = run(&folder, "b.ls", &with("'N U T, 0, 0, 9'"), "");
    assert_eq!(corrected, all - 1, "{left}");
    assert!(left.contains("joint 6 between 3060° and 3420°"), "{left}");
    // Without a letter that the arm does not have, or with the letter of a side that no branch shows.
    for stated in ["'N U, 0, 0, 0'", "'N R U T, 0, 0, 0'", "'N U T, 0, 0'"] {
        let found = run(&folder, "b.ls", &with(stated), "");
        assert_eq!(found, (all, String::new()), "{stated}");
    }
}

/// The first instruction of a listing, with and without a remark before it.
#[test]
fn the_first_instruction_of_a_listing_counts() {
    let folder = folder();
    let text = String::from_utf8_lossy(&file("part.ls")).replace("\r\n", "\n");
    let (from, to) = (text.find("   1:").unwrap(), text.find("   4:J").unwrap());
    for remark in ["", "   1:  !first ;\n"] {
        let text = format!("{}{remark}{}", &text[..from], &text[to..]);
        assert_eq!(run(&folder, "b.ls", &text, ""), (5, String::new()));
    }
}

/// External axes, frames that the job sets, and shifts on some way to a position.
#[test]
fn positions_of_a_job_that_something_moves_are_left() {
    let folder = folder();
    let text = String::from_utf8_lossy(&file("part.jbi")).replace("\r\n", "\n");
    let all = run(&folder, "a.jbi", &text, "").0;
    for (line, corrected, reason) in [
        (
            "MOVL C00001 BC00001 V=200.0",
            all - 1,
            "it has external axes",
        ),
        (
            "MFRAME UF#(2) P001 P002 P003",
            all - 3,
            "its frame or tool is set",
        ),
        ("SETTOOL TL#(1) P001", all, ""),
        ("SFTON P001\nSFTOF", all, ""),
        (
            "JUMP *A IF IN#(1)=ON\nSFTON P001\n*A",
            0,
            "a shift may be active",
        ),
        ("IFTHENEXP IN#(1)=ON\nSFTON P001\nSFTOF\nENDIF", all, ""),
    ] {
        let text = text.replace("NOP\n", &format!("NOP\n{line}\n"));
        check_whole(&folder, "b.jbi", &text, corrected, reason);
    }
    let end = text.replace("MOVJ C00004", "SFTON P001\nJUMP *A\nMOVJ C00004");
    let end = end.replace("NOP\n", "NOP\n*A\n");
    check_whole(&folder, "b.jbi", &end, 0, "a shift may be active");
}

/// A listing that is called sets frames, payloads and sensors; one that is in no file is named.
#[test]
fn called_listings_are_read() {
    let folder = folder();
    let text = String::from_utf8_lossy(&file("part.ls")).replace("\r\n", "\n");
    folder.write(
        "b.ls",
        text.replace("   4:J", "   4:  CALL SETF(1) ;\n   4:J"),
    );
    let run = |rest: &str| {
        let command = "correct elas.blob b.ls --frames frames.toml --json - --out out.ls";
        let outcome = folder.run(&format!("{command} {rest}"));
        assert!(matches!(outcome.code, Some(0 | 1)), "{outcome:#?}");
        let targets = outcome.json()["targets"].as_u64();
        (targets, outcome.stdout)
    };
    let (targets, said) = run("--payload-kg 2.5");
    assert_eq!(targets, Some(5));
    let note = "b.ls:10: routines in none of the files: SETF: it is assumed that they set no tool";
    assert!(said.contains(note), "{said}");
    for (line, corrected, reason) in [
        ("R[1]=2", 5, ""),
        (
            "UFRAME[2]=PR[5]",
            2,
            "its frame or tool is set at setf.ls:3",
        ),
        ("UTOOL_NUM=5", 2, "UTOOL_NUM is 5 at the motion to it"),
        (
            "Touch Offset PR[1]",
            0,
            "Touch Offset at setf.ls:3 shifts its end",
        ),
        ("Touch Offset PR[1] ;\n Touch Offset End", 5, ""),
        ("PAYLOAD[3]", 5, "setf.ls:3: PAYLOAD selects a mass"),
    ] {
        let listing = format!("/PROG  SETF\n/MN\n   1:  {line} ;\n/POS\n/END\n");
        folder.write("setf.ls", listing);
        let (targets, said) = run("--payload-kg 2.5 --with setf.ls");
        assert_eq!(targets, Some(corrected), "{line}\n{said}");
        assert!(said.contains(reason), "{line}\n{said}");
        assert!(!said.contains("in none of the files"), "{line}\n{said}");
    }
}
