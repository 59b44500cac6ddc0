//! The device as a whole without hardware: frames in, frames out, over a simulated NOR flash.

mod authority;
mod bits;
mod commands;
mod cuts;
mod cycles;
mod cyclic_frames;
mod desk;
mod documentation;
mod every_switch;
mod frames;
mod keys;
mod known;
#[path = "../../store/nor.rs"]
#[allow(dead_code)] // the tests of the store use the rest
mod nor;
mod self_test;
mod sequences;
mod slots;
mod soak;
mod uploads;
