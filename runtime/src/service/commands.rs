//! The commands of a controller's cycle: their timing, and the filter through which they go.

use core::num::NonZeroU32;

use heapless::Vec;
use poegp_protocol::link::{CycleSettings, Query};

use crate::filter::{CommandFilter, FilterError, FilterSettings, Filtered};
use crate::guard::status::Status;
use crate::service::exchange::BoardInfo;

/// Commands count as stopped after 1/[`QUIET`] s without one. The filter never waits longer for a command.
const QUIET: u32 = 2;

/// Returns the settings in force until others are set: those of [`FilterSettings::default`], and what the board allows.
const fn default_settings(max_instructions: u32) -> CycleSettings {
    CycleSettings {
        period_us: 1_000,
        rate: 0.02,
        acceleration: 0.5,
        blend_s: 0.5,
        max_instructions,
    }
}

/// The filter, and what it needs to know about time.
///
/// ```text
///  command    0      1         2        3   3′               4  5
///  time      -|------|---------|--------|---|----------------|--|   in periods, counted from the last command that counts
///  cycles     ∞      1         1        1   0                2  1   rounded; 0 for a repeated one; ∞ after a stop
/// ```
///
/// A command that comes early after a late one (5) is not repeated, but back in time: see [`Commands::late`].
///
/// Time is the difference of two tick counts, which wrap around. Two measures keep a long stop from being taken for a short
/// time: a caller that looks at the clock for another reason reports it ([`Commands::look`]), and half a second without a
/// command is remembered as a stop.
#[derive(Debug)]
pub(super) struct Commands {
    pub(super) filter: CommandFilter<f32>,
    /// Settings in force.
    pub(super) settings: CycleSettings,
    tick_hz: u32,
    period_ticks: NonZeroU32,
    /// Whether commands have stopped.
    quiet: bool,
    /// Whether the last command came in a cyclic frame.
    in_cyclic_frames: bool,
    /// Tick at which the last command came that did not fall into an already answered cycle.
    last: u32,
    /// Ticks by which that command was late, and the next one may be early; at most half a period. So up to half a period of
    /// jitter beyond the usual half costs no cycle, and yet commands count no faster for long.
    late: u32,
    sequence: u16,
    query: Query,
}

impl Commands {
    /// Starts before the first command, with default settings.
    pub(super) fn new(board: &BoardInfo) -> Self {
        let settings = default_settings(board.max_instructions);
        let mut new = Self {
            filter: CommandFilter::new(),
            settings,
            tick_hz: board.tick_hz,
            period_ticks: NonZeroU32::MIN,
            quiet: true,
            in_cyclic_frames: false,
            last: 0,
            late: 0,
            sequence: 0,
            query: Query {
                joints: Vec::new(),
                payload_kg: 0.0,
            },
        };
        // This cannot be refused, because nothing is applied yet.
        let _ = new.configure(&settings);
        new
    }

    /// Applies settings, unless a correction is applied.
    pub(super) fn configure(&mut self, settings: &CycleSettings) -> Result<(), FilterError> {
        self.filter.configure(&for_filter(settings))?;
        self.settings = *settings;
        // `f32` is accurate to a ten-millionth, as the clock is. Wider integers would need a division routine of their own.
        let ticks = settings.period_us as f32 * self.tick_hz as f32 / 1e6;
        self.period_ticks = NonZeroU32::new((ticks + 0.5) as u32).unwrap_or(NonZeroU32::MIN);
        Ok(())
    }

    /// Notes that it is `now`, or was a moment ago, but not before the last command.
    #[inline(always)]
    pub(super) fn look(&mut self, now: u32) {
        self.quiet |= now.wrapping_sub(self.last) > self.tick_hz / QUIET;
    }

    /// Notes that no more commands will come.
    pub(super) fn stop(&mut self) {
        self.quiet = true;
    }

    /// Returns whether a model may be exchanged: nothing is applied, or nobody sends commands that could step.
    pub(super) fn is_free(&self) -> bool {
        self.quiet || self.filter.disengaged()
    }

    /// Returns the cycles from the previous command to this one, which came at `arrived`: the nearest number, 1 for a command
    /// that is early by no more than the previous one was late, 0 for a repeated request, and `u32::MAX` after a stop.
    pub(super) fn cycles(&mut self, sequence: u16, query: &Query, arrived: u32) -> u32 {
        let since = arrived.wrapping_sub(self.last);
        let period = self.period_ticks;
        let half = period.get() / 2;
        let since_due = since.saturating_add(self.late);
        let cycles = if self.quiet {
            u32::MAX
        } else if sequence == self.sequence && same(query, &self.query) {
            0
        } else {
            // Rounds up from half a period on, for an odd number of ticks, too.
            let up = period.get() - half;
            let rounded = since / period + u32::from(since % period >= up);
            rounded.max(u32::from(since_due >= up))
        };
        if cycles != 0 {
            let late = since_due.saturating_sub(period.get()).min(half);
            self.late = if self.quiet { 0 } else { late };
            self.last = arrived;
        }
        (self.quiet, self.in_cyclic_frames) = (false, false);
        self.sequence = sequence;
        self.query.clone_from(query);
        cycles
    }

    /// Returns [`Commands::cycles`] for a command in a cyclic frame; `None` when its sequence number is that of the previous
    /// frame, so that it does not count.
    pub(super) fn cyclic_frame(
        &mut self,
        sequence: u16,
        query: &Query,
        arrived: u32,
    ) -> Option<u32> {
        if self.in_cyclic_frames() && sequence == self.sequence {
            return None;
        }
        let cycles = self.cycles(sequence, query, arrived);
        self.in_cyclic_frames = true;
        Some(cycles)
    }

    /// Returns whether commands are coming, and in cyclic frames.
    pub(super) fn in_cyclic_frames(&self) -> bool {
        self.in_cyclic_frames && !self.quiet
    }

    /// See [`CommandFilter::step`].
    pub(super) fn step(
        &mut self,
        corrected: &[f32],
        status: Status,
        engage: bool,
        cycles: u32,
    ) -> Filtered<f32> {
        let command = &self.query.joints;
        self.filter.step(command, corrected, status, engage, cycles)
    }
}

/// Returns whether both queries have the same bits.
fn same(one: &Query, other: &Query) -> bool {
    let bits = |value: &f32| value.to_bits();
    let joints = one
        .joints
        .iter()
        .map(bits)
        .eq(other.joints.iter().map(bits));
    joints && one.payload_kg.to_bits() == other.payload_kg.to_bits()
}

/// Converts settings of the cycle to those of the filter.
pub(super) fn for_filter(settings: &CycleSettings) -> FilterSettings<f32> {
    FilterSettings {
        period_s: settings.period_us as f32 / 1e6,
        rate: settings.rate,
        acceleration: settings.acceleration,
        blend_s: settings.blend_s,
    }
}
