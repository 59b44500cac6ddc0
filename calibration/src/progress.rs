//! How far a calibration has come, for whoever waits for it in the same thread.
//!
//! The unit is one evaluation of a likelihood. How many of them a search takes nobody knows before, so a phase is given as
//! many as usual, stands still at its end when it takes more, and jumps there when it takes fewer. Nothing here changes what
//! is computed; without a listener it costs a look into a thread-local.

use std::cell::RefCell;

/// What a listener is told: units done, units in all as far as is known.
type Listener = Box<dyn FnMut(u64, u64)>;

struct State {
    listener: Listener,
    done: u64,
    end_of_phase: u64,
    expected: u64,
}

thread_local! {
    static STATE: RefCell<Option<State>> = const { RefCell::new(None) };
}

/// Does `work`, with `listener` told of its progress.
pub fn watched<R>(listener: impl FnMut(u64, u64) + 'static, work: impl FnOnce() -> R) -> R {
    /// Takes the listener away, also when the work panics.
    struct Guard;
    impl Drop for Guard {
        fn drop(&mut self) {
            STATE.with(|state| state.take());
        }
    }
    STATE.with(|state| {
        state.replace(Some(State {
            listener: Box::new(listener),
            done: 0,
            end_of_phase: 0,
            expected: 0,
        }))
    });
    let _guard = Guard;
    work()
}

/// Announces `units` of work more.
pub fn expect(units: u64) {
    change(|state| state.expected += units);
}

/// Does `work`, which is `units` of what was announced.
pub fn phase<R>(units: u64, work: impl FnOnce() -> R) -> R {
    change(|state| state.end_of_phase = state.done + units);
    let out = work();
    change(|state| state.done = state.end_of_phase);
    out
}

/// One unit of a phase is done.
pub fn step() {
    change(|state| state.done = (state.done + 1).min(state.end_of_phase));
}

fn change(change: impl FnOnce(&mut State)) {
    STATE.with(|state| {
        if let Some(state) = state.borrow_mut().as_mut() {
            change(state);
            let expected = state.expected.max(state.done);
            (state.listener)(state.done, expected);
        }
    });
}

#[cfg(test)]
mod tests {
    use std::rc::Rc;

    use super::*;

    #[test]
    fn phases_end_where_they_were_announced_to() {
        let told = Rc::new(RefCell::new(Vec::new()));
        let heard = Rc::clone(&told);
        let answer = watched(
            move |done, all| heard.borrow_mut().push((done, all)),
            || {
                expect(5);
                // Fewer steps than usual, then more.
                phase(3, step);
                phase(2, || (0..4).for_each(|_| step()));
                7
            },
        );
        assert_eq!(answer, 7);
        let told = told.borrow();
        assert!(told.windows(2).all(|w| w[0].0 <= w[1].0), "{told:?}");
        assert!(told.contains(&(1, 5)) && told.contains(&(3, 5)));
        assert_eq!(told.last(), Some(&(5, 5)));
        let before = told.len();
        // Nobody listens any more.
        step();
        assert_eq!(told.len(), before);
    }
}
