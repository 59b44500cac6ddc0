//! The bytes of `poegp-protocol`: what values look like at rest and on the wire, and that nothing damaged is believed.

mod blob;
mod capacity;
mod cobs;
mod cyclic;
mod envelope;
mod frame;
mod link;
mod listing;
mod messages;
mod receiver;
mod releases;
mod sample;
mod texts;
