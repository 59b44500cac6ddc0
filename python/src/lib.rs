//! The native part of the Python package `poegp`: arrays in, arrays out, every formula the workspace's.
//!
//! The layers, each of which uses those before it: `errors`, `arrays`, `table`, `options`, `commands`, `model`.

mod arrays;
mod commands;
mod errors;
mod model;
mod options;
mod table;

use pyo3::prelude::*;

/// The native part of `poegp`.
#[pymodule]
mod _native {
    use pyo3::prelude::*;

    #[pymodule_export]
    use crate::commands::{Calibration, calibrate, compare, correct_program, export, plan};
    #[pymodule_export]
    use crate::model::{NativeModel, status_flags};

    /// The commands say nothing: a library has no terminal.
    #[pymodule_init]
    fn init(module: &Bound<'_, PyModule>) -> PyResult<()> {
        poegp_trainer::cli::embedded::be_silent();
        module.add("__version__", env!("CARGO_PKG_VERSION"))
    }
}
