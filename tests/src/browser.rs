//! Headless Chromium, spoken to by the DevTools protocol over pipes, and a server of files for it.

use std::{
    env, fs,
    io::{BufRead, BufReader, Read, Write},
    net::{TcpListener, TcpStream},
    path::{Path, PathBuf},
    process::{Child, ChildStdin, Command, Stdio},
    sync::mpsc::{Receiver, RecvTimeoutError, channel},
    thread,
    time::{Duration, Instant},
};

use base64::{Engine as _, engine::general_purpose::STANDARD};
use image::RgbImage;
use serde_json::{Value, json};

/// How long a page may take for anything, software rendering on a busy machine included.
const PATIENCE: Duration = Duration::from_secs(120);

/// What makes it draw WebGL without a graphics card, and without reaching out.
const SWITCHES: &[&str] = &[
    "--headless",
    "--remote-debugging-pipe",
    // Tests may run as root, where there is no sandbox; every page is ours.
    "--no-sandbox",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--force-color-profile=srgb",
    "--hide-scrollbars",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-dev-shm-usage",
];

/// A program on the path, by the first of its names that is there.
pub(crate) fn program(names: &[&str]) -> Option<PathBuf> {
    let path = env::var_os("PATH")?;
    let folders: Vec<PathBuf> = env::split_paths(&path).collect();
    names.iter().flat_map(|n| folders.iter().map(move |f| f.join(n))).find(|p| p.is_file())
}

/// npm, or `None`, which prints that `test` is skipped.
#[must_use]
pub fn npm(test: &str) -> Option<PathBuf> {
    let found = program(&["npm"]);
    if found.is_none() {
        skip(test, "npm is not installed");
    }
    found
}

/// Says that `test` is skipped.
///
/// # Panics
/// Where the environment says that browsers are to be tested (`REQUIRE_BROWSER=1`).
#[expect(clippy::print_stdout, reason = "a skipped test says so")]
pub fn skip(test: &str, why: &str) {
    assert!(env::var_os("REQUIRE_BROWSER").is_none(), "{test}: {why}");
    println!("skipped: {test}: {why}");
}

/// A page in a browser of its own.
#[derive(Debug)]
pub struct Page {
    child: Child,
    to: Option<ChildStdin>,
    from: Receiver<Value>,
    session: Option<String>,
    next: u64,
    said: Vec<String>,
    _profile: tempfile::TempDir,
}

impl Page {
    /// Starts Chromium with an empty page; `None`, which prints that `test` is skipped, where there is none.
    ///
    /// # Panics
    /// If it is there but cannot be spoken to.
    #[must_use]
    pub fn open(test: &str, width: u32, height: u32) -> Option<Self> {
        let found = program(&["chromium", "chromium-browser", "google-chrome"]).filter(|_| cfg!(unix));
        let Some(program) = found else {
            skip(test, "Chromium is not installed");
            return None;
        };
        let profile = tempfile::tempdir().expect("a temporary folder");
        // It reads commands from descriptor 3 and answers on 4.
        let mut child = Command::new("sh")
            .args(["-c", r#"exec "$0" "$@" 3<&0 4>&1 </dev/null >/dev/null 2>&1"#])
            .arg(program)
            .args(SWITCHES)
            .arg(format!("--user-data-dir={}", profile.path().display()))
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .expect("a shell");
        let (to, out) = (child.stdin.take(), child.stdout.take().expect("a pipe"));
        let (sender, from) = channel();
        thread::spawn(move || {
            for message in BufReader::new(out).split(0) {
                let Ok(message) = message else { return };
                if let Ok(message) = serde_json::from_slice(&message)
                    && sender.send(message).is_err()
                {
                    return;
                }
            }
        });
        let said = Vec::new();
        let mut page = Self { child, to, from, session: None, next: 0, said, _profile: profile };
        let target = page.call("Target.createTarget", json!({ "url": "about:blank" }));
        let attach = json!({ "targetId": target["targetId"], "flatten": true });
        page.session = page.call("Target.attachToTarget", attach)["sessionId"].as_str().map(str::to_owned);
        for domain in ["Page.enable", "Runtime.enable"] {
            let _ = page.call(domain, json!({}));
        }
        page.resize(width, height);
        Some(page)
    }

    /// Gives the page a size in pixels.
    pub fn resize(&mut self, width: u32, height: u32) {
        let size = json!({ "width": width, "height": height, "deviceScaleFactor": 1, "mobile": false });
        let _ = self.call("Emulation.setDeviceMetricsOverride", size);
    }

    /// Goes to an address and waits until `data-ready` is there.
    ///
    /// # Panics
    /// If the page says `data-failed`, or nothing.
    #[track_caller]
    pub fn visit(&mut self, url: &str) {
        let _ = self.call("Page.navigate", json!({ "url": url }));
        self.wait("document.documentElement.dataset.ready");
    }

    /// Waits until an expression is true.
    ///
    /// # Panics
    /// If the page says `data-failed`, or after two minutes.
    #[track_caller]
    pub fn wait(&mut self, expression: &str) {
        let begun = Instant::now();
        loop {
            let failed = self.evaluate("document.documentElement.dataset.failed && document.body.innerText");
            assert!(failed.is_null(), "the page failed: {failed}\n{:?}", self.said);
            if self.evaluate(&format!("Boolean({expression})")) == json!(true) {
                return;
            }
            assert!(begun.elapsed() < PATIENCE, "{expression} is not true\n{:?}", self.said);
            thread::sleep(Duration::from_millis(50));
        }
    }

    /// The value of an expression in the page, null where it has none.
    pub fn evaluate(&mut self, expression: &str) -> Value {
        let asked = json!({ "expression": expression, "returnByValue": true, "awaitPromise": true });
        self.call("Runtime.evaluate", asked)["result"]["value"].clone()
    }

    /// Presses and releases a key, as in `press("KeyW", "w")`.
    pub fn press(&mut self, code: &str, key: &str) {
        for kind in ["keyDown", "keyUp"] {
            let _ = self.call("Input.dispatchKeyEvent", json!({ "type": kind, "code": code, "key": key }));
        }
    }

    /// Waits for two frames and takes a picture.
    ///
    /// # Panics
    /// If there is none.
    #[must_use]
    pub fn picture(&mut self) -> RgbImage {
        let frames = "new Promise((r) => requestAnimationFrame(() => requestAnimationFrame(() => r(1))))";
        let _ = self.evaluate(frames);
        let shot = self.call("Page.captureScreenshot", json!({ "format": "png" }));
        let png = STANDARD.decode(shot["data"].as_str().expect("a picture")).expect("base64");
        image::load_from_memory(&png).expect("PNG").to_rgb8()
    }

    /// Errors and warnings of the page so far.
    #[must_use]
    pub fn said(&self) -> &[String] {
        &self.said
    }

    #[track_caller]
    fn call(&mut self, method: &str, params: Value) -> Value {
        self.next += 1;
        let mut message = json!({ "id": self.next, "method": method, "params": params });
        if let Some(session) = &self.session {
            message["sessionId"] = json!(session);
        }
        let mut bytes = message.to_string().into_bytes();
        bytes.push(0);
        let to = self.to.as_mut().expect("a pipe");
        to.write_all(&bytes).and_then(|()| to.flush()).expect("Chromium takes commands");
        loop {
            match self.from.recv_timeout(PATIENCE) {
                Ok(answer) if answer["id"] == json!(self.next) => {
                    assert!(answer.get("error").is_none(), "{method}: {}", answer["error"]);
                    return answer["result"].clone();
                }
                Ok(event) => self.note(&event),
                Err(RecvTimeoutError::Timeout) => panic!("{method}: no answer\n{:?}", self.said),
                Err(RecvTimeoutError::Disconnected) => {
                    panic!("{method}: Chromium has ended\n{:?}", self.said)
                }
            }
        }
    }

    /// Remembers what the page complains of.
    fn note(&mut self, event: &Value) {
        let params = &event["params"];
        match event["method"].as_str() {
            Some("Runtime.exceptionThrown") => self.said.push(params["exceptionDetails"].to_string()),
            Some("Runtime.consoleAPICalled") if params["type"] == "error" || params["type"] == "warning" => {
                self.said.push(params["args"].to_string());
            }
            _ => {}
        }
    }
}

impl Drop for Page {
    fn drop(&mut self) {
        // With its pipe it loses its reason to be; that it is gone is what the profile's removal waits for.
        drop(self.to.take());
        let begun = Instant::now();
        while begun.elapsed() < Duration::from_secs(5) {
            if matches!(self.child.try_wait(), Ok(Some(_))) {
                return;
            }
            thread::sleep(Duration::from_millis(20));
        }
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Serves the files of `root` on this machine alone until the process ends; the address without a final slash.
///
/// # Panics
/// If no port is free.
#[must_use]
pub fn serve(root: &Path) -> String {
    let listener = TcpListener::bind(("127.0.0.1", 0)).expect("a free port");
    let address = format!("http://{}", listener.local_addr().expect("an address"));
    let root = root.to_owned();
    thread::spawn(move || {
        for stream in listener.incoming().flatten() {
            let root = root.clone();
            thread::spawn(move || answer(&root, stream));
        }
    });
    address
}

/// Answers one request; a connection that breaks is the browser's affair.
fn answer(root: &Path, mut stream: TcpStream) {
    let mut request = Vec::new();
    let mut piece = [0; 1024];
    while !request.windows(4).any(|w| w == b"\r\n\r\n") {
        match stream.read(&mut piece) {
            Ok(n) if 0 < n => request.extend_from_slice(&piece[..n]),
            _ => return,
        }
    }
    let request = String::from_utf8_lossy(&request);
    let path = request.split_whitespace().nth(1).unwrap_or_default();
    let path = path.split('?').next().unwrap_or_default().trim_start_matches('/');
    let found = if path.contains("..") { None } else { fs::read(root.join(path)).ok() };
    let kind = match path.rsplit('.').next() {
        Some("html") => "text/html",
        Some("js") => "text/javascript",
        Some("json") => "application/json",
        _ => "application/octet-stream",
    };
    let (status, body) = found.map_or(("404 Not Found", Vec::new()), |body| ("200 OK", body));
    let head = format!(
        "HTTP/1.1 {status}\r\nContent-Type: {kind}\r\nContent-Length: {}\r\nConnection: close\r\n\r\n",
        body.len()
    );
    let _ = stream.write_all(head.as_bytes()).and_then(|()| stream.write_all(&body));
}
