//! Calibration by touches: laws of its rows and of its fit, and its errors on simulated and real sets.

mod boards;
mod holes;
mod jacobians;
mod judged;
mod kinds;
mod knocks;
mod laws;
mod lengths;
mod measured;
mod rates;
mod scales;
mod sets;
mod sisters;
mod stated;
mod steps;
mod time;
mod trial;
mod trust;
mod wires;
