//! Frames, gravity coefficients and gear ripple as one linearised model.

pub mod fit;
pub mod gear_line;
pub mod ripple;
pub mod state;
