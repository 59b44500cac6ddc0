# Short names for commands of `cargo` and `tests/run`; neither needs `just`.

# Formatting, lints, unit tests and laws: under a minute after one change.
check:
    tests/run --quick

# Tests whose path has NAME in it.
test NAME:
    cargo test --workspace --exclude poegp-firmware -- {{NAME}}

# Every law and unit test of the libraries.
laws:
    cargo test -p poegp-protocol -p poegp-runtime -p poegp-calibration --lib --tests

# Rewrites the program's texts, robot programs, the C header and golden bits; read the difference.
bless:
    POEGP_BLESS=1 cargo test -p poegp-trainer --lib --test cli --test documents --test documents_no
    POEGP_BLESS=1 cargo test -p poegp-capi --test header
    POEGP_BLESS=1 cargo test -p poegp-tests --test device -- golden

# Every check.
full:
    tests/run
