use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::*;

const ROB: &str = "<Rob Type=\"KUKA\"><RIst X=\"1.5\" Y=\"0.0\" Z=\"2\" A=\"0\" B=\"90\" C=\"0\"/>\
    <AIPos A1=\"9\" A2=\"9\" A3=\"9\" A4=\"9\" A5=\"9\" A6=\"9\"/>\
    <ASPos A1=\"10.5\" A2=\"-90\" A3=\"90.25\" A4=\"0\" A5=\"1e1\" A6=\"-180\"/><Delay D=\"0\"/><IPOC>123645634563</IPOC></Rob>";

fn commanded(text: &str) -> Option<Packet> {
    read(text.as_bytes(), Setpoint::Commanded)
}

#[test]
fn a_packet_of_a_controller() {
    let packet = commanded(ROB).unwrap();
    assert_eq!(packet.ipoc, 123_645_634_563);
    let degrees = [10.5, -90.0, 90.25, 0.0, 10.0, -180.0];
    assert_eq!(packet.axes, Some(degrees.map(f64::to_radians)));
    let actual = read(ROB.as_bytes(), Setpoint::Actual).unwrap();
    assert_eq!(actual.axes, Some([9.0_f64.to_radians(); 6]));
}

/// The order of attributes and elements, spaces, line ends, comments and what is not asked for do not matter.
#[test]
fn form_does_not_matter() {
    let text = "<?xml version='1.0'?>\r\n<Rob>\n <IPOC> 123645634563\n</IPOC><!-- A1 --><Tech C1='1'><ASPos A1='7'/><IPOC>1</IPOC></Tech>\
        <ASPos B='x' A6='-180' A5='10.000' A4='-0.0' A3=' 90.25 ' A2='-9.0e1' A1='+10.5'></ASPos></Rob>\n";
    assert_eq!(commanded(text), commanded(ROB));
}

/// What has a time stamp is answered, with the correction held.
#[test]
fn axes_that_cannot_be_used() {
    let bad = [
        ("A1=\"10.5\"", ""),
        ("A1=\"10.5\"", "A1=\"\""),
        ("A1=\"10.5\"", "A1=\"nan\""),
        ("A1=\"10.5\"", "A1=\"-inf\""),
        ("A1=\"10.5\"", "A1=\"1e999\""),
        ("A1=\"10.5\"", "A1=\"10,5\""),
        ("A1=\"10.5\"", "A1=\"&#49;\""),
        ("A1=\"10.5\"", "A1=\"10.5\" A1=\"10.5\""),
        ("A1=\"10.5\"", "a1=\"10.5\""),
        ("<Delay D=\"0\"/>", "<ASPos A1=\"1\"/>"),
        ("ASPos", "Other"),
    ];
    for (from, to) in bad {
        assert!(ROB.contains(from));
        let packet = commanded(&ROB.replace(from, to));
        let held = Packet {
            ipoc: 123_645_634_563,
            axes: None,
        };
        assert_eq!(packet, Some(held), "{to}");
    }
}

#[test]
fn what_has_no_answer() {
    let whole = "<IPOC>123645634563</IPOC>";
    let bad = [
        (whole, ""),
        (whole, "<IPOC/>"),
        (whole, "<IPOC>-4</IPOC>"),
        (whole, "<IPOC>4.0</IPOC>"),
        (whole, "<IPOC>18446744073709551616</IPOC>"),
        (whole, "<IPOC>4</IPOC><IPOC>8</IPOC>"),
        (whole, "<IPOC>4<b/>8</IPOC>"),
        (whole, "<IPOC><b>4</b></IPOC>"),
        (whole, "<IPOC>&amp;</IPOC>"),
        ("<Rob ", "<Sen "),
        ("</Rob>", ""),
        ("</Rob>", "</Rob></Rob>"),
        ("</Rob>", "</Rob><Rob/>"),
        ("</Rob>", "</Rob>4"),
        ("<Rob ", "<!DOCTYPE Rob><Rob "),
        ("<Delay D=\"0\"/>", "<Delay D=0/>"),
        ("<Delay D=\"0\"/>", "<Delay>"),
    ];
    for (from, to) in bad {
        assert!(ROB.contains(from));
        assert_eq!(commanded(&ROB.replace(from, to)), None, "{to}");
    }
    let padding = " ".repeat(MAX_PACKET - ROB.len());
    assert!(commanded(&format!("{ROB}{padding}")).is_some());
    assert_eq!(commanded(&format!("{ROB}{padding} ")), None);
    assert_eq!(commanded(""), None);
}

/// Whatever comes is read, or not, and what is read is finite.
#[test]
fn arbitrary_bytes_never_panic() {
    let mut random = ChaCha8Rng::seed_from_u64(20);
    for _ in 0..20_000 {
        let mut bytes = ROB.as_bytes().to_vec();
        for _ in 0..random.random_range(1..6) {
            let at = random.random_range(0..bytes.len());
            match random.random_range(0..3) {
                0 => bytes[at] = random.random(),
                1 => bytes.truncate(at.max(1)),
                _ => bytes.insert(at, b"<>\"=/&0"[at % 7]),
            }
        }
        if let Some(axes) = read(&bytes, Setpoint::Commanded).and_then(|packet| packet.axes) {
            assert!(axes.iter().all(|q| q.is_finite()));
        }
    }
}

/// The numbers of an answer, by another way back: decimals without an exponent, the time stamp digit by digit.
#[test]
fn an_answer() {
    let mut out = b"old".to_vec();
    let axes = [0, 1, -1, 1_000_000, -12_345_678, 999_999];
    write(u64::MAX, &axes, &mut out);
    assert_eq!(
        String::from_utf8(out).unwrap(),
        "<Sen Type=\"ImFree\"><AK A1=\"0.000000\" A2=\"0.000001\" A3=\"-0.000001\" A4=\"1.000000\" A5=\"-12.345678\" \
         A6=\"0.999999\"/><IPOC>18446744073709551615</IPOC></Sen>"
    );
    let mut random = ChaCha8Rng::seed_from_u64(21);
    for _ in 0..2_000 {
        let rad: Axes = std::array::from_fn(|_| 0.2 * random.random::<f64>() - 0.1);
        let mut out = Vec::new();
        write(random.random(), &micro_degrees(&rad), &mut out);
        let text = String::from_utf8(out).unwrap();
        for (axis, rad) in rad.iter().enumerate() {
            let start = format!("A{}=\"", axis + 1);
            let number = text
                .split(&start)
                .nth(1)
                .unwrap()
                .split('"')
                .next()
                .unwrap();
            assert_eq!(number.split('.').nth(1).unwrap().len(), 6);
            let degrees: f64 = number.parse().unwrap();
            assert!((degrees - rad.to_degrees()).abs() <= 0.500_001e-6);
        }
    }
}
