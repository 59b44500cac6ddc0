//! A calibrated arm for other programs: URDF, MJCF, the Universal Robots driver's YAML, tables of frames or DH rows, joint
//! zeros, a C header.
//!
//! Other programs know chains of frames and nothing else, so what all of them get is the calibrated chain of a blob
//! ([`CalibratedChain`]), the same poses to a nanometre in every form. What such a form cannot hold (gravity, gear ripple,
//! Gaussian processes, coupled joints) is left out and named ([`CalibratedChain::not_carried`]); only the C header has
//! the whole model.
//!
//! A chain does not fix its frames: a joint's frame may slide along and turn about the joint's own axis and the poses of
//! the target stay. [`gauge`] uses that freedom to keep every link where the nominal description has it, so that meshes
//! and inertias fit.

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
