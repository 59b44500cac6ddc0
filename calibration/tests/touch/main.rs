//! Calibration by touches: laws of its rows, and what it reaches on sets of others.

mod jacobians;
mod judged;
mod kinds;
mod measured;
mod sets;
mod wires;
