//! Commands in cyclic frames.

use poegp_protocol::link::Query;
use poegp_protocol::link::cyclic::{self, MAX_CYCLIC};
use poegp_protocol::link::frame::{MAX_FRAME, Received, Receiver};

use super::{Script, Talk};

/// Returns sequence number and command of a cyclic frame without its final zero; no command if its length is that of none.
pub(super) fn command_in(bytes: &[u8]) -> Option<(u16, Option<Query>)> {
    if bytes.len() > MAX_FRAME {
        return None;
    }
    let mut receiver = Receiver::new();
    for byte in bytes {
        receiver.push(*byte);
    }
    if receiver.push(0) != Received::Frame {
        return None;
    }
    let sequence = receiver.open().ok()?;
    Some((sequence, cyclic::command(receiver.cyclic()?)))
}

impl Talk<'_, '_> {
    /// Sends a cyclic frame with a command, or one whose length is that of no command.
    pub(super) fn cyclic_frame(&mut self, sequence: u16, command: Option<&Query>, frame: &[u8]) {
        let expected = self.expected.cyclic_frame(sequence, command);
        let expected = expected.map(|answer| {
            let mut out = [0; MAX_CYCLIC];
            let bytes = cyclic::encode_answer(sequence, &answer, &mut out).expect("room");
            bytes[..bytes.len() - 1].to_vec()
        });
        let bytes = [frame, &[0]].concat();
        let sent = self.device.sent(&bytes);
        assert!(sent.iter().eq(&expected), "{sent:?}, expected {expected:?}");
    }

    /// Sends a short path, one command for each cycle; some frames are repeated, some are damaged.
    pub(super) fn commands_in_frames(&mut self, script: &mut Script<'_>) {
        let mut query = script.query();
        let (steps, slope) = (script.below(64), f32::from(script.byte() as i8) * 1e-4);
        let (period, trouble) = (u32::from(script.byte() % 16), script.byte());
        for step in 0..=steps {
            self.wait(if period > 11 { 1 } else { period });
            for joint in &mut query.joints {
                *joint += slope;
            }
            let troubled = trouble % 8 == step as u8 % 8;
            if !troubled || trouble < 128 {
                self.sequence = self.sequence.wrapping_add(1);
            }
            let mut out = [0; MAX_CYCLIC];
            let frame = cyclic::encode_command(self.sequence, &query, &mut out).expect("room");
            let mut frame = frame[..frame.len() - 1].to_vec();
            if troubled && trouble < 64 {
                let at = usize::from(trouble) % frame.len();
                frame[at] ^= 1 << (trouble % 7);
                self.noise(&frame);
            } else {
                // A device accepts no command without joints.
                let command = (!query.joints.is_empty()).then_some(&query);
                self.cyclic_frame(self.sequence, command, &frame);
            }
        }
    }
}
