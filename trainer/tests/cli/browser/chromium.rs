//! A headless Chromium, driven by the DevTools protocol over a pipe: JSON messages, each ended by a NUL.
//!
//! It needs no crate and no port: a shell connects standard input and output with the file descriptors 3 and 4, which Chromium
//! uses with `--remote-debugging-pipe`.

use std::io::{BufRead, BufReader, Write};
use std::path::Path;
use std::process::{Child, ChildStdin, Command, Stdio};
use std::sync::mpsc::{Receiver, channel};
use std::time::{Duration, Instant};

use serde_json::{Value, json};
use tempfile::TempDir;

/// Longest wait for an answer, since a machine that runs other tests is slow.
const PATIENCE: Duration = Duration::from_secs(120);
const FLAGS: &str = "--headless --no-sandbox --disable-gpu --disable-quic --no-first-run --disable-background-networking \
    --disable-component-update --disable-sync --hide-scrollbars --force-color-profile=srgb --remote-debugging-pipe";

/// The keys that the tests press, with their codes.
const KEYS: [(&str, u32); 7] = [
    ("Tab", 9),
    ("Escape", 27),
    ("End", 35),
    ("Home", 36),
    ("ArrowLeft", 37),
    ("ArrowRight", 39),
    ("Enter", 13),
];
/// The modifier for Shift.
pub const SHIFT: u32 = 8;

pub struct Browser {
    child: Child,
    to: ChildStdin,
    from: Receiver<Value>,
    last: u64,
    session: Value,
    /// Errors, warnings, violations of the policy, and dialogs.
    pub complaints: Vec<String>,
    /// Requested addresses.
    pub requests: Vec<String>,
    _profile: TempDir,
}

/// Returns the command of an installed Chromium.
fn installed() -> Option<&'static str> {
    let names = ["chromium", "chromium-browser", "google-chrome"];
    let runs = |name: &&str| {
        let version = Command::new(name).arg("--version").output();
        version.is_ok_and(|output| output.status.success())
    };
    names.into_iter().find(runs)
}

impl Browser {
    /// Opens an empty page, 1100 wide. Prints NOT RUN if no Chromium is installed.
    pub fn start(test: &str) -> Option<Self> {
        let Some(command) = installed() else {
            // Shown even when the test harness captures output.
            let _ = writeln!(
                std::io::stderr(),
                "NOT RUN: {test} in a browser, for no chromium is installed"
            );
            return None;
        };
        let profile = TempDir::new().unwrap();
        let script = format!(
            "exec {command} {FLAGS} --user-data-dir=\"$1\" about:blank 3<&0 4>&1 0</dev/null 1>/dev/null 2>/dev/null"
        );
        let mut child = Command::new("sh")
            .args(["-c", &script, "sh"])
            .arg(profile.path())
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let to = child.stdin.take().unwrap();
        let mut answers = BufReader::new(child.stdout.take().unwrap());
        let (give, from) = channel();
        std::thread::spawn(move || {
            let mut message = Vec::new();
            while answers.read_until(0, &mut message).is_ok_and(|n| n > 0) {
                let value = serde_json::from_slice(message.strip_suffix(b"\0").unwrap_or(&message));
                if give.send(value.unwrap()).is_err() {
                    break;
                }
                message.clear();
            }
        });
        let mut browser = Self {
            child,
            to,
            from,
            last: 0,
            session: Value::Null,
            complaints: Vec::new(),
            requests: Vec::new(),
            _profile: profile,
        };
        let target = browser.call("Target.createTarget", json!({"url": "about:blank"}));
        let target = &target["targetId"];
        let attached = browser.call(
            "Target.attachToTarget",
            json!({"targetId": target, "flatten": true}),
        );
        browser.session = attached["sessionId"].clone();
        for domain in ["Page", "Runtime", "Log", "Network"] {
            browser.call(&format!("{domain}.enable"), json!({}));
        }
        browser.size(1100, 900);
        Some(browser)
    }

    /// Sends a command and returns its answer.
    #[track_caller]
    pub fn call(&mut self, method: &str, parameters: Value) -> Value {
        self.last += 1;
        let mut message = json!({"id": self.last, "method": method, "params": parameters});
        if !self.session.is_null() {
            message["sessionId"] = self.session.clone();
        }
        let mut bytes = serde_json::to_vec(&message).unwrap();
        bytes.push(0);
        self.to.write_all(&bytes).unwrap();
        loop {
            let mut answer = self.message(method);
            if answer["id"] == self.last {
                assert!(answer.get("error").is_none(), "{method}: {answer}");
                return answer["result"].take();
            }
        }
    }

    /// Returns the next message, and keeps complaints and requests of the page.
    #[track_caller]
    fn message(&mut self, during: &str) -> Value {
        let message = self.from.recv_timeout(PATIENCE);
        let message = message.unwrap_or_else(|e| panic!("chromium does not answer {during}: {e}"));
        let event = &message["params"];
        match message["method"].as_str().unwrap_or_default() {
            "Runtime.exceptionThrown" | "Runtime.consoleAPICalled" | "Log.entryAdded" => {
                self.complaints.push(event.to_string());
            }
            "Page.javascriptDialogOpening" => self.complaints.push(format!("dialog: {event}")),
            "Network.requestWillBeSent" => {
                let url = event["request"]["url"].as_str().unwrap();
                self.requests.push(url.to_owned());
            }
            _ => {}
        }
        message
    }

    /// Opens a file and waits until it is loaded.
    #[track_caller]
    pub fn open(&mut self, file: &Path) {
        let url = format!("file://{}", file.display());
        self.call("Page.navigate", json!({"url": url}));
        let begin = Instant::now();
        while self.evaluate("document.readyState + location.protocol") != "completefile:" {
            assert!(begin.elapsed() < PATIENCE, "{url} is not loaded");
            std::thread::sleep(Duration::from_millis(20));
        }
    }

    /// Returns the value of an expression in the page.
    #[track_caller]
    pub fn evaluate(&mut self, expression: &str) -> Value {
        let parameters =
            json!({"expression": expression, "returnByValue": true, "awaitPromise": true});
        let mut answer = self.call("Runtime.evaluate", parameters);
        assert!(
            answer.get("exceptionDetails").is_none(),
            "{expression}: {answer}"
        );
        answer["result"]["value"].take()
    }

    /// Returns a text of the page.
    #[track_caller]
    pub fn text(&mut self, expression: &str) -> String {
        let value = self.evaluate(expression);
        value
            .as_str()
            .unwrap_or_else(|| panic!("{expression}: {value}"))
            .to_owned()
    }

    /// Presses and releases a key.
    #[track_caller]
    pub fn press(&mut self, key: &str, modifiers: u32) {
        let code = KEYS.iter().find(|k| k.0 == key).unwrap().1;
        for kind in ["rawKeyDown", "keyUp"] {
            self.call(
                "Input.dispatchKeyEvent",
                json!({"type": kind, "key": key, "code": key, "windowsVirtualKeyCode": code, "modifiers": modifiers}),
            );
        }
    }

    /// Sends `mouseMoved`, `mousePressed` or `mouseReleased` at a point of the window.
    #[track_caller]
    pub fn mouse(&mut self, kind: &str, (x, y): (f64, f64)) {
        let held = u32::from(kind == "mousePressed");
        let button = if kind == "mouseMoved" { "none" } else { "left" };
        self.call(
            "Input.dispatchMouseEvent",
            json!({"type": kind, "x": x, "y": y, "button": button, "buttons": held, "clickCount": 1}),
        );
    }

    /// Sets width and height of the window.
    #[track_caller]
    pub fn size(&mut self, width: u32, height: u32) {
        let size =
            json!({"width": width, "height": height, "deviceScaleFactor": 1, "mobile": false});
        self.call("Emulation.setDeviceMetricsOverride", size);
    }

    /// Sets the colour scheme `light` or `dark`, on a `screen` or in `print`.
    #[track_caller]
    pub fn media(&mut self, medium: &str, scheme: &str) {
        let features = json!([{"name": "prefers-color-scheme", "value": scheme}]);
        self.call(
            "Emulation.setEmulatedMedia",
            json!({"media": medium, "features": features}),
        );
    }
}

impl Drop for Browser {
    fn drop(&mut self) {
        // Chromium ends with its pipe; then its profile can be removed.
        let _ = self
            .to
            .write_all(b"{\"id\":0,\"method\":\"Browser.close\"}\0");
        let begin = Instant::now();
        while begin.elapsed() < Duration::from_secs(5) {
            if matches!(self.child.try_wait(), Ok(Some(_))) {
                return;
            }
            std::thread::sleep(Duration::from_millis(20));
        }
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
