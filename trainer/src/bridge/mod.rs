//! Live correction: a controller sends its setpoints in every cycle, and adds the correction that the bridge answers.
//!
//! [`rsi`] implements KUKA's interface for that, the Robot Sensor Interface. Transport, timing and XML are in this module;
//! the computation is the runtime's: model, filter and bound, in `f64`.
//!
//! ```text
//!  datagram ──> message ──> sequence ──> corrector: correct ──> filter ──> bound ──> message ──> datagram
//! ```

pub mod corrector;
pub mod message;
pub mod rsi;
pub mod sequence;
pub mod server;
pub mod statistics;

/// Number of axes that RSI reports and corrects: A1 to A6.
pub const AXES: usize = 6;

/// One value for each axis.
pub type Axes = [f64; AXES];
