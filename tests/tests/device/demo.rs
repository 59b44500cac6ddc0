//! The demonstration with a device.

use poegp_tests::demo;

#[test]
fn the_device_corrects_the_simulated_arm() {
    let mut printed = Vec::new();
    let rows = demo::run(1, &mut printed).unwrap_or_else(|error| panic!("{error}"));
    let printed = String::from_utf8(printed).unwrap();
    let [before, paper, elastic] = &rows[..] else {
        panic!("{rows:#?}");
    };
    assert!(before.position_mm.mean > 1.0, "{printed}");
    // Without commands near singularities, which are corrected in part, the elastic error would be 0.02 mm; with them it is
    // 0.09.
    for (row, most) in [(paper, 0.4), (elastic, 0.1)] {
        assert!(row.position_mm.mean < most, "{printed}");
        assert!(printed.contains(row.name), "{printed}");
    }
}
