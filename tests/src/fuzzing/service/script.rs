//! A script of the fuzzer, read byte by byte.

use poegp_protocol::link::Query;

/// A source of numbers from a script; zeros after its end.
pub(super) struct Script<'a>(pub(super) &'a [u8]);

impl<'a> Script<'a> {
    pub(super) fn bytes(&mut self, count: usize) -> &'a [u8] {
        let (taken, rest) = self.0.split_at(count.min(self.0.len()));
        self.0 = rest;
        taken
    }

    pub(super) fn byte(&mut self) -> u8 {
        self.bytes(1).first().copied().unwrap_or(0)
    }

    pub(super) fn below(&mut self, end: usize) -> usize {
        usize::from(self.byte()) % end
    }

    pub(super) fn word(&mut self) -> u32 {
        u32::from_le_bytes(std::array::from_fn(|_| self.byte()))
    }

    pub(super) fn query(&mut self) -> Query {
        let joints = match self.below(12) {
            9 => 3,
            10 | 11 => 6,
            count => count,
        };
        let raw = self.byte().is_multiple_of(4);
        let mut number = || match raw {
            true => f32::from_bits(self.word()),
            false => f32::from(self.byte() as i8) / 32.0,
        };
        Query {
            joints: (0..joints).map(|_| number()).collect(),
            payload_kg: number(),
        }
    }
}
