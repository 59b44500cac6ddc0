//! The store in a flash that loses power: at every operation, in every way, in every short sequence of steps.

mod cuts;
mod damage;
mod key;
mod laws;
mod nor;
mod settings;
mod steps;
