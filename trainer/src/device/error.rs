//! What can go wrong between a workstation and a device, and what to do about it.

use std::io;

use poegp_protocol::link::{PROTOCOL_VERSION, Refusal};

use crate::device::messages;

/// Why there is no answer, or not the one that was hoped for.
#[derive(Debug, thiserror::Error)]
pub enum ClientError {
    /// The port does not open.
    #[error("{port} does not open: {error}\nhelp: {advice}")]
    Open {
        /// Its name.
        port: String,
        /// What the system says.
        error: io::Error,
        /// What to try.
        advice: String,
    },
    /// The port was open and is no longer.
    #[error(
        "the link to the device at {port} ended: {error}\nhelp: was it unplugged or switched off?"
    )]
    Lost {
        /// Its name.
        port: String,
        /// What the system says.
        error: io::Error,
    },
    /// Not one byte came.
    #[error(
        "no answer at {port}\nhelp: is the board powered, and is this its port? Another one may have the log"
    )]
    Nobody {
        /// Its name.
        port: String,
    },
    /// Bytes came, and no frame was intact.
    #[error(
        "{port} sent {bytes} bytes and no intact frame\n\
         help: wrong baud rate (--baud), or the port of the log, or no device of this kind"
    )]
    Noise {
        /// Its name.
        port: String,
        /// Bytes that came.
        bytes: u64,
    },
    /// The device speaks another version of the protocol.
    #[error(
        "the device at {port} speaks link protocol version {found}, this trainer version {PROTOCOL_VERSION}\n\
         help: {}", version_help(*.found)
    )]
    Version {
        /// Its name.
        port: String,
        /// Protocol version of the device.
        found: u8,
    },
    /// What is sent arrives damaged, every time.
    #[error(
        "what is sent to the device at {port} arrives damaged, every time\nhelp: check the cable and its ground"
    )]
    Damaged {
        /// Its name.
        port: String,
    },
    /// The device has answered, and does not any more.
    #[error(
        "the device at {port} has answered before, and not to {request} ({attempts} attempts)\n\
         help: was it switched off? A bad line loses answers, too: `trainer device statistics`"
    )]
    NoAnswer {
        /// Its name.
        port: String,
        /// What was asked.
        request: String,
        /// How often.
        attempts: u32,
    },
    /// The device is busy with another service for too long.
    #[error("the device at {port} stays busy\nhelp: is another workstation using it?")]
    Busy {
        /// Its name.
        port: String,
    },
    /// The device will not.
    #[error("the device refused: {}", messages::refusal(.0))]
    Refused(Refusal),
    /// The device answered something else.
    #[error(
        "the device answered {request} with {response}\nhelp: firmware and trainer do not belong together"
    )]
    Unexpected {
        /// What was asked.
        request: String,
        /// What was answered.
        response: String,
    },
}

fn version_help(found: u8) -> &'static str {
    if found > PROTOCOL_VERSION {
        "use the trainer that belongs to the firmware"
    } else {
        "put newer firmware on the board, or use the trainer that belongs to it"
    }
}
