//! The C interface.
#[test]
fn placeholder() {
    assert!(poegp_tests::firmware::firmware().is_ok());
}
