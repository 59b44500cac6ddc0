//! Errors between a workstation and a device, with advice.

use std::io;

use poegp_protocol::link::{PROTOCOL_VERSION, Refusal};

use crate::device::messages;

/// Reason why there is no answer, or not the expected one.
#[derive(Debug, thiserror::Error)]
pub enum ClientError {
    /// The port does not open.
    #[error("{port} does not open: {error}\nhelp: {advice}")]
    Open {
        /// Name of the port.
        port: String,
        /// Error of the operating system.
        error: io::Error,
        /// Advice for the user.
        advice: String,
    },
    /// The port was open and has closed.
    #[error(
        "the link to the device at {port} ended: {error}\nhelp: was it unplugged or switched off?"
    )]
    Lost {
        /// Name of the port.
        port: String,
        /// Error of the operating system.
        error: io::Error,
    },
    /// No byte was received.
    #[error(
        "no answer at {port}\nhelp: is the board powered, and is this its port? Another one may have the log"
    )]
    Nobody {
        /// Name of the port.
        port: String,
    },
    /// Bytes were received, but no intact frame.
    #[error(
        "{port} sent {bytes} bytes and no intact frame\nhelp: check the baud rate (--baud), and that this is the port \
         of a poegp device and not of its log"
    )]
    Noise {
        /// Name of the port.
        port: String,
        /// Number of bytes that were received.
        bytes: u64,
    },
    /// The device speaks another version of the protocol.
    #[error(
        "the device at {port} speaks link protocol version {found}, this trainer version {PROTOCOL_VERSION}\n\
         help: {}", version_help(*.found)
    )]
    Version {
        /// Name of the port.
        port: String,
        /// Protocol version of the device.
        found: u8,
    },
    /// Requests arrive damaged at the device, every time.
    #[error(
        "every request to the device at {port} arrives damaged\nhelp: check the cable and its ground"
    )]
    Damaged {
        /// Name of the port.
        port: String,
    },
    /// The device has answered before, but does not any more.
    #[error(
        "the device at {port} has answered before, but not to {request} ({attempts} attempts)\nhelp: was it switched \
         off? A bad line loses answers, too: `trainer device statistics`"
    )]
    NoAnswer {
        /// Name of the port.
        port: String,
        /// Name of the request.
        request: String,
        /// Number of attempts.
        attempts: u32,
    },
    /// The device is busy with another service for too long.
    #[error("the device at {port} stays busy\nhelp: is another workstation using it?")]
    Busy {
        /// Name of the port.
        port: String,
    },
    /// The device refused the request.
    #[error("the device refused: {}", messages::refusal(.0))]
    Refused(Refusal),
    /// The device sent an answer that does not belong to the request.
    #[error(
        "the device answered {request} with {response}\nhelp: firmware and trainer are of different versions"
    )]
    Unexpected {
        /// Name of the request.
        request: String,
        /// Received answer.
        response: String,
    },
}

fn version_help(found: u8) -> &'static str {
    if found > PROTOCOL_VERSION {
        "use the trainer of the firmware's release"
    } else {
        "put newer firmware on the board, or use the trainer of its release"
    }
}
