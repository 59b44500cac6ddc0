//! Calibration by touches: laws of its rows, and what it reaches on sets of others.

mod holes;
mod jacobians;
mod judged;
mod kinds;
mod laws;
mod lengths;
mod measured;
mod sets;
mod sisters;
mod stated;
mod time;
mod trial;
mod trust;
mod wires;
