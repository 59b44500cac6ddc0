//! Exports of a calibrated arm for other programs: URDF, MJCF, the Universal Robots driver's YAML, tables of frames or DH
//! rows, joint zeros, a C header.
//!
//! Other programs know only chains of frames, so all of them get the calibrated chain of a blob ([`CalibratedChain`]): the
//! same poses to a nanometre in every format. What no chain can hold (gravity, gear ripple, Gaussian processes) is
//! left out and named ([`CalibratedChain::not_carried`]), and so is the coupling in files of links and joints; only the C
//! header has the whole model.
//!
//! The poses of a chain do not determine its frames: a joint's frame may slide along the joint's own axis and turn about it
//! without moving the target. [`gauge`] uses that freedom to keep every link where the nominal description has it, so that
//! meshes and inertias fit.

pub mod c_header;
pub(crate) mod calibrated_chain;
pub mod csv;
pub mod describe;
pub mod dh;
pub(crate) mod format;
pub mod gauge;
pub mod joint_zeros;
pub mod mjcf;
pub mod poe;
pub(crate) mod tables;
pub mod universal_robots;
pub mod urdf;
pub mod urdf_patch;
mod xml;

pub use crate::export::calibrated_chain::CalibratedChain;
pub use crate::export::tables::Table;
