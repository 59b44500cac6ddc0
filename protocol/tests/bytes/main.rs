//! The bytes of `poegp-protocol`: values in storage and on the wire, and that damaged bytes are refused.

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
