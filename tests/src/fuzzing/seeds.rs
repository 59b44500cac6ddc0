//! Valid inputs for each fuzz target: files of this repository, truncated, and small blobs.

use std::fs;
use std::path::Path;

use ed25519_dalek::SigningKey;
use poegp_calibration::simulation::touches::{TOUCH_KINDS, TouchKind, TouchTask};
use poegp_calibration::simulation::{Scenario, Simulator};
use poegp_protocol::link::{Query, Refusal, Request, Response, Statistics};

use super::service::{SMALL, signed};
use super::wire::wire;
use crate::sample::{Elastic, Sample, SampleCorrection};
use crate::workspace;

/// Returns the files of a folder of the repository in the order of their names, truncated after a line to at most `longest`
/// bytes so that changes hit relevant parts.
fn files(folder: &str, extension: &str, longest: usize) -> Vec<Vec<u8>> {
    let folder = workspace().join(folder);
    let entries = fs::read_dir(&folder).unwrap_or_else(|e| panic!("{}: {e}", folder.display()));
    let mut paths: Vec<_> = entries
        .map(|entry| entry.expect("a file").path())
        .filter(|path| path.extension().is_some_and(|found| found == extension))
        .collect();
    paths.sort();
    assert!(!paths.is_empty(), "no .{extension} in {}", folder.display());
    let read = |path: &Path| cut(fs::read(path).expect("a file"), longest);
    paths.iter().map(|path| read(path)).collect()
}

fn cut(mut bytes: Vec<u8>, longest: usize) -> Vec<u8> {
    if bytes.len() > longest {
        let end = bytes[..longest].iter().rposition(|byte| *byte == b'\n');
        bytes.truncate(end.map_or(longest, |at| at + 1));
    }
    bytes
}

/// Returns small blobs of every kind and format, one of them signed.
pub fn blobs() -> Vec<Vec<u8>> {
    let kinds = [
        SampleCorrection::None,
        SampleCorrection::Shared(3),
        SampleCorrection::Folded(3),
        SampleCorrection::PerOutput(2),
        SampleCorrection::Elastic(SMALL),
        SampleCorrection::Elastic(Elastic {
            upright: false,
            landmarks: 2,
            ..SMALL
        }),
        SampleCorrection::Elastic(Elastic {
            looks_at: 2,
            points: 8,
            ..SMALL
        }),
    ];
    let mut blobs: Vec<_> = (1..)
        .zip(kinds)
        .map(|(seed, kind)| Sample::plain(seed, kind).blob())
        .collect();
    let coupled = Sample {
        coupled: true,
        sliding: 1,
        joints: 4,
        ..Sample::plain(8, SampleCorrection::Elastic(SMALL))
    };
    let variance = Sample {
        landmarks: 5,
        ..Sample::plain(9, SampleCorrection::Folded(3))
    };
    blobs.extend([coupled.blob(), variance.blob()]);
    blobs.push(signed(&blobs[0], 7, &SigningKey::from_bytes(&[1; 32])));
    blobs
}

/// Returns requests and responses, framed and as bare messages.
pub fn frames() -> Vec<Vec<u8>> {
    let query = || Query {
        joints: [0.1, -0.7, 0.0].into_iter().collect(),
        payload_kg: 2.5,
    };
    let requests = [
        Request::Identify,
        Request::Evaluate(query()),
        Request::Correct(query()),
        Request::BeginUpload {
            length: 9_000,
            crc: 7,
            replaces_robot: false,
        },
        Request::Signed {
            signature: &[3; 64],
            request: &[14],
        },
        Request::UploadChunk {
            offset: 256,
            bytes: &[0, 1, 2, 0xff],
        },
        Request::Provision {
            public_key: [9; 32],
        },
        Request::Command(query()),
    ];
    let responses = [
        Response::Uploading { received: 256 },
        Response::Statistics(Statistics::default()),
        Response::Refused(Refusal::UnexpectedOffset {
            found: 1,
            expected: 2,
        }),
    ];
    let framed = requests.iter().map(|request| wire(1, request));
    let framed: Vec<_> = framed
        .chain(responses.iter().map(|response| wire(1, response)))
        .collect();
    // The bytes between the frame's head and its checksum; COBS changes only the first bytes there.
    let bare = framed
        .iter()
        .map(|frame| frame[4..frame.len() - 4].to_vec());
    let mut all: Vec<_> = bare.collect();
    all.push(framed.join(&0));
    all.extend(framed);
    all
}

/// Returns scripts for the service: the steps of `service::Talk::step`.
pub fn scripts() -> Vec<Vec<u8>> {
    let install = |blob: u8| [27, blob, 15, 17, blob];
    let ask = [
        1, 10, 1, 5, 6, 7, 8, 9, 10, 11, 3, 10, 1, 5, 6, 7, 8, 9, 10, 11,
    ];
    // `Talk::command`: three joints, `count` commands, a slope, one command in a period.
    let path = |count: u8| [195, 3, 1, 5, 6, 7, 8, count, 9, 12];
    let [a, b, c] = [0, 1, 2].map(install);
    let script = |parts: &[&[u8]]| [&[1][..], &parts.concat()].concat();
    vec![
        script(&[&a, &ask, &b, &ask, &[20, 0], &ask, &[25], &ask]),
        script(&[
            &c,
            &[23, 0],
            &a,
            &[27, 3, 15, 17, 3],
            &ask,
            &[26],
            &ask,
            &[20, 0],
        ]),
        script(&[
            &[
                7, 1, 9, 40, 9, 3, 12, 0, 0, 0, 0, 2, 1, 2, 11, 14, 16, 19, 24,
            ],
            &ask,
        ]),
        script(&[&a, &[22, 1], &ask, &[25, 3, 2, 1, 1, 2, 3, 22, 0, 6]]),
        script(&[&[
            27, 4, 29, 2, 9, 0, 0, 0, 1, 19, 30, 1, 13, 31, 5, 1, 2, 3, 4, 5,
        ]]),
        script(&[
            &a,
            &b,
            &c,
            &[20, 0, 20, 0],
            &[26],
            &ask,
            &[8, 9, 9, 0, 0, 1, 1, 1, 1],
        ]),
        // Commands of three joints: blended in, an activation in the middle, bypass, a repetition, a gap, settings.
        script(&[
            &a,
            &[194, 1, 0, 0, 0, 2],
            &path(60),
            &path(60),
            &[192, 24],
            &b,
            &path(60),
            &[20, 0],
            &path(60),
            &path(60),
            &[0, 22, 1],
            &path(60),
            &path(60),
            &[194, 1, 1, 1, 1, 2, 22, 0],
            &path(60),
            &[193, 250, 193, 6],
            &path(20),
            &[6, 19, 0, 25],
            &path(30),
        ]),
        [
            &[0][..],
            &a,
            &ask,
            &b,
            &[6],
            &b,
            &[15, 5, 3, 0, 0, 0, 192, 127],
            &ask,
        ]
        .concat(),
    ]
}

/// Returns measurement files.
pub fn measurements() -> Vec<Vec<u8>> {
    let mut all = files("tests/data/simulated", "csv", 600);
    all.truncate(4);
    let more: [&[u8]; 4] = [
        b"# a comment\nq1_rad,q2_mm,x_m,y_m,z_m,qw,qx,qy,qz,payload_kg,session,target,sigma_mm\n\
          0.1,20,1,2,3,1,0,0,0,0.5,mon,a,0.03\n-0.2,30,1.1,2.1,3.1,0.5,0.5,0.5,0.5,0,tue,\"b, c\",0.02\n",
        b"q1_deg;q2_deg;x_mm;y_mm;z_mm\n1;2;3;4;5\n",
        b"\xef\xbb\xbfq1_deg,q2_deg,q3_deg,payload_kg\r\n1,2,3,0.5\r\n4,5,6,1e1\r\n",
        b"q1_deg,x_mm,y_mm,z_mm,sigma_mm,sigma_mrad\n1,2,3,4,0.1,0.2\n",
    ];
    all.extend(more.map(<[u8]>::to_vec));
    all
}

fn import_file(name: &str) -> Vec<u8> {
    let path = workspace().join("tests/data/import").join(name);
    cut(fs::read(&path).expect("a file of the repository"), 700)
}

/// The raw files of `tests/data/import`, one for each map.
const RAWS: [&str; 8] = [
    "comma.csv",
    "euler.csv",
    "german.csv",
    "matrix_3x4.csv",
    "matrix_4x4.csv",
    "matrix_9.csv",
    "spaces.txt",
    "tabs.txt",
];
/// Raw files that consist of two files.
const PAIRS: [&str; 2] = ["leica", "points"];

/// Returns maps with their raw files, separated by zero bytes.
pub fn imports() -> Vec<Vec<u8>> {
    let map = |stem: &str| {
        let text = String::from_utf8(import_file(&format!("{stem}.toml"))).expect("text");
        // The map of the Euler angles is a template.
        let text = text.replace("ORDER", "ZYX").replace("AXES", "intrinsic");
        text.into_bytes()
    };
    let one = RAWS.map(|raw| {
        let stem = raw.split('.').next().expect("a name");
        [map(stem), import_file(raw)].join(&0)
    });
    let two = PAIRS.map(|stem| {
        let [points, joints] = ["{}.txt", "{}_joints.csv"].map(|name| name.replace("{}", stem));
        [map(stem), import_file(&points), import_file(&joints)].join(&0)
    });
    let all = one.into_iter().chain(two).chain(foreign_files());
    all.chain([workbook()]).collect()
}

/// Returns a map, poses, and their joints on a sheet of a workbook.
fn workbook() -> Vec<u8> {
    let map = b"file = { separator = \"semicolon\" }\njoints_file = { sheet = \"Measured\", skip_lines = 2 }\n\
        joints = { driver = \"fanuc\" }\nposition = { columns = [\"X\", \"Y\", \"Z\"] }\njoin = { by = \"order\" }\n";
    let file = |name: &str| import_file(&format!("simulated/{name}"));
    [map.to_vec(), file("tracker.csv"), file("workbook.xlsx")].join(&0)
}

/// Maps that join files and make poses of reflectors, with files.
fn foreign_files() -> [Vec<u8>; 3] {
    let joined = b"joints_file = { separator = \"space\" }\njoints = { driver = \"ur-rtde\" }\n\
        position = { columns = [\"X\", \"Y\", \"Z\"] }\n\
        join = { by = \"time\", poses = \"t\", joints = \"timestamp\", joints_unit = \"s\", tolerance_s = 0.1 }\n\0\
        t [ms],X [in],Y [in],Z [in]\n1000,1,2,3\n2000,4,5,6\n\0\
        timestamp actual_q_0 actual_q_1\n0.5 1 2\n1.01 0.5 0.25\n1.99 0.75 1\n";
    let reflectors = b"joints = { driver = \"fanuc\" }\n[reflectors]\n\
        columns = [[\"a\", \"b\", \"c\"], [\"d\", \"e\", \"f\"], [7, 8, 9]]\n\
        at = [[0, 0, 0], [100, 0, 0], [0, 80, 0]]\nat_unit = \"mm\"\n\0\
        a [mm],b [mm],c [mm],d [mm],e [mm],f [mm],g [mm],h [mm],i [mm],J1,J2\n1,2,3,101,2,3,1,82,3,10,20\n";
    let dated = b"joints_file = { separator = \"comma\" }\njoints = { driver = \"panda\" }\n\
        position = { columns = [\"X\", \"Y\", \"Z\"] }\njoin = { by = \"time\", poses = \"t\", joints = \"t\", poses_unit = \"iso8601\", \
        joints_unit = \"iso8601\", tolerance_s = 0.1 }\n\0\
        t,X [in],Y [in],Z [in]\n2026-11-23T14:05:09.125Z,1,2,3\n2026-11-23 15:05:11+01:00,4,5,6\n\0\
        t,panda_joint1,panda_joint2\n2026-11-23T14:05:09.13Z,1,2\n2026-11-23T14:05:11Z,0.5,0.25\n";
    [joined.to_vec(), reflectors.to_vec(), dated.to_vec()]
}

/// Returns raw files without maps; pairs are separated by two zero bytes.
pub fn raws() -> Vec<Vec<u8>> {
    let mut all: Vec<_> = RAWS.map(import_file).into();
    all.extend(PAIRS.map(|stem| {
        let [points, joints] = ["{}.txt", "{}_joints.csv"].map(|name| name.replace("{}", stem));
        [import_file(&points), import_file(&joints)].join(&[0, 0][..])
    }));
    all.push(import_file("unicode.txt"));
    all
}

/// Returns URDFs: the short ones of the repository, and a small one with every kind of joint.
pub fn urdfs() -> Vec<Vec<u8>> {
    let mut all = files("tests/data/robots", "urdf", usize::MAX);
    all.extend(files("tests/data/urdf", "urdf", usize::MAX));
    all.retain(|bytes| bytes.len() < 12_000);
    all.push(
        br#"<?xml version="1.0"?><robot name="a"><link name="b"/><link name="c"/><link name="d"/><link name="tool0"/>
<joint name="j1" type="revolute"><origin xyz="0 0 .1" rpy="0 1 0"/><parent link="b"/><child link="c"/><axis xyz="0 0 1"/>
<limit lower="-1" upper="1" effort="0" velocity="1"/></joint>
<joint name="j2" type="prismatic"><parent link="c"/><child link="d"/><axis xyz="1 0 0"/>
<limit lower="0" upper="1" effort="0" velocity="1"/><mimic joint="j1" multiplier="2"/></joint>
<joint name="f" type="fixed"><origin xyz="0 0 .1"/><parent link="d"/><child link="tool0"/></joint></robot>"#
            .to_vec(),
    );
    all
}

/// Returns robot descriptions in TOML.
pub fn tomls() -> Vec<Vec<u8>> {
    files("calibration/robots", "toml", usize::MAX)
}

/// Returns constraints of a plan: the example of the documentation and a short one.
pub fn cells() -> Vec<Vec<u8>> {
    let page = fs::read_to_string(workspace().join("docs/guide/measuring.md")).expect("a page");
    let listing = page
        .split("```")
        .find_map(|block| block.strip_prefix("toml\n"));
    let short =
        "[[joint]]\nname=\"joint_2\"\nrange_rad=[-1,1]\n[line_of_sight]\ninstrument_m=[1,2,3]\n";
    vec![
        listing.expect("a listing of TOML").as_bytes().to_vec(),
        short.as_bytes().to_vec(),
    ]
}

/// Returns touches of every kind, each after the description of its features and a zero byte.
pub fn touches() -> Vec<Vec<u8>> {
    let robot = super::readers::six_axes();
    let seed = |(_, kind): (&str, TouchKind)| {
        let mut simulator = Simulator::new(&robot, Scenario::Paper, &[0.0], 3);
        let tasks = [TouchTask { kind, features: 2 }];
        let touched = simulator.touch(&robot, &tasks, 8, 0, "simulated");
        let (touches, _) = touched.expect("features within reach");
        format!("{}\0{}", touches.toml, touches.csv).into_bytes()
    };
    TOUCH_KINDS.map(seed).into()
}

/// Returns names that contain markup.
pub fn names() -> Vec<Vec<u8>> {
    let names = [
        "</title><script>alert(1)</script>",
        "\"><img src=x onerror=alert(1)>",
        "&lt;&amp;&#60;",
        "]]><!-- -->",
        "cell 7, left arm",
        "' onload='x",
    ];
    names.map(|name| name.as_bytes().to_vec()).into()
}

/// Returns a small program of `tests/data/programs`.
fn program(name: &str) -> Vec<u8> {
    fs::read(workspace().join("tests/data/programs").join(name)).expect("a program")
}

/// Returns ABB modules.
pub fn rapid() -> Vec<Vec<u8>> {
    vec![program("part.mod")]
}

/// Returns scripts of Universal Robots.
pub fn urscript() -> Vec<Vec<u8>> {
    vec![program("part.script")]
}

/// Returns Fanuc listings, one with its tools and frames.
pub fn fanuc() -> Vec<Vec<u8>> {
    let variables = "[*SYSTEM*]$MNUTOOL  Storage: CMOS  Access: RW  : ARRAY[1,10] OF POSITION\r\n     [1,3] =\r\n\
        Group: 1   Config: N D B, 0, 0, 0\r\n  X:    30.000   Y:   -45.000   Z:   210.000\r\n\
        W:    25.000   P:     0.000   R:     0.000\r\n";
    let listing = program("part.ls");
    let both = [listing.as_slice(), b"\0", variables.as_bytes()].concat();
    vec![both, listing]
}

/// Returns KUKA sources, one with its data list.
pub fn krl() -> Vec<Vec<u8>> {
    let (source, data) = (program("part.src"), program("part.dat"));
    vec![[source.as_slice(), b"\0", &data].concat(), source]
}

/// Returns Yaskawa jobs, one with its tools and frames.
pub fn inform() -> Vec<Vec<u8>> {
    let conditions = "//TOOL 3\r\n///NAME GUN\r\n30,-45,210,25,0,0\r\n0,0,15\r\n2.5\r\n//UFRAME 2\r\n\
        ////BUSER 900,-300,420,0,0,20\r\n";
    let job = program("part.jbi");
    vec![[job.as_slice(), b"\0", conditions.as_bytes()].concat(), job]
}

/// Tables of poses.
pub fn table() -> Vec<Vec<u8>> {
    vec![program("part.csv")]
}

/// Returns data of a Stäubli controller, with a program that uses them.
pub fn val3() -> Vec<Vec<u8>> {
    let (data, code) = (program("part.dtx"), program("part.pgx"));
    vec![[data.as_slice(), b"\0", &code].concat()]
}

/// Returns sessions of a controller, packet by packet: one that moves and ends with bad axes, and one with gaps and
/// repeats.
pub fn rsi() -> Vec<Vec<u8>> {
    let packet = |ipoc: u64, a1: &str| {
        format!(
            "<Rob Type=\"KUKA\"><ASPos A1=\"{a1}\" A2=\"-9.5\" A3=\"12\" A4=\"0\" A5=\"40.25\" A6=\"1e1\"/>\
             <Delay D=\"0\"/><IPOC>{ipoc}</IPOC></Rob>\0"
        )
    };
    let moving = (0..40).map(|cycle| packet(4 * cycle, &format!("{}.5", cycle / 4)));
    let moving: String = moving.chain([packet(160, "NaN")]).collect();
    let gaps = [
        8, 8, 12, 16, 20, 24, 28, 32, 36, 40, 44, 48, 56, 52, 9_000, 9_004, 9_008,
    ];
    let gaps: String = gaps.iter().map(|ipoc| packet(*ipoc, "3.25")).collect();
    vec![moving.into_bytes(), gaps.into_bytes()]
}
