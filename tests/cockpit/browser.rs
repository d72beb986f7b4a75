//! Chromium, driven from Rust through playwright-core, in a folder of its own: one for all tests.

use std::{
    cell::OnceCell,
    collections::HashMap,
    io::{BufRead as _, BufReader, Write as _},
    path::{Path, PathBuf},
    process::{ChildStdin, Command, Stdio},
    sync::{
        Arc, Condvar, LazyLock, Mutex,
        atomic::{AtomicU64, Ordering},
        mpsc::{self, SyncSender},
    },
    thread,
    time::Duration,
};

use serde_json::{Value, json};

/// The folder with the packages of npm, made once; says why where there is none.
pub(crate) static PACKAGES: LazyLock<Option<PathBuf>> = LazyLock::new(|| match packages() {
    Ok(folder) => Some(folder),
    Err(cause) => {
        eprintln!("skipped: no browser to look with: {cause}");
        None
    }
});

fn packages() -> Result<PathBuf, String> {
    if !Path::new("/usr/bin/chromium").exists() {
        let packages = ["chromium", "fonts-dejavu-core"];
        run(Command::new("apt-get").args(["install", "-y", "-qq", "--no-install-recommends"]).args(packages))?;
    }
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("cockpit");
    if !["typescript/bin/tsc", "@foxglove/ws-protocol"]
        .iter()
        .all(|package| folder.join("node_modules").join(package).exists())
    {
        std::fs::create_dir_all(&folder).map_err(|cause| cause.to_string())?;
        let install = ["install", "--no-audit", "--no-fund", "--prefix", "."];
        let packages = ["playwright-core@1.64.1", "typescript@5.9.3", "@foxglove/ws-protocol@0.8.0", "ws@8.23.0"];
        run(Command::new("npm").args(install).args(packages).current_dir(&folder))?;
    }
    Ok(folder)
}

/// Tests whose pages draw at a time: as many as there are processors, for they draw without a graphics card.
static SEATS: (Mutex<usize>, Condvar) = (Mutex::new(0), Condvar::new());

/// The seat of a test; it is free again when the test's thread has ended.
struct Seat;

impl Seat {
    fn take() -> Self {
        let (taken, freed) = &SEATS;
        let most = thread::available_parallelism().map_or(1, usize::from);
        *freed.wait_while(taken.lock().unwrap(), |taken| *taken >= most).unwrap() += 1;
        Self
    }
}

impl Drop for Seat {
    fn drop(&mut self) {
        let (taken, freed) = &SEATS;
        *taken.lock().unwrap() -= 1;
        freed.notify_one();
    }
}

/// Waits until this test may have its pages.
pub(crate) fn seated() {
    thread_local!(static SEAT: OnceCell<Seat> = const { OnceCell::new() });
    SEAT.with(|seat| _ = seat.get_or_init(Seat::take));
}

/// Runs a program to its end; what it said where it failed.
pub(crate) fn run(command: &mut Command) -> Result<String, String> {
    let output = command.stdin(Stdio::null()).output().map_err(|cause| format!("{command:?}: {cause}"))?;
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    if output.status.success() { Ok(text(&output.stdout)) } else { Err(text(&output.stdout) + &text(&output.stderr)) }
}

/// The browser of all tests: to begin one takes as long as many a test.
struct Browser {
    input: Mutex<ChildStdin>,
    /// Who waits for the answer of a number.
    asked: Arc<Mutex<HashMap<u64, SyncSender<Value>>>>,
    next: AtomicU64,
}

/// It ends with its standard input, and so with the tests.
static BROWSER: LazyLock<Option<Browser>> = LazyLock::new(|| PACKAGES.as_deref().map(Browser::start));

/// An answer that takes longer does not come: the browser has shorter limits.
const ANSWER_LIMIT: Duration = Duration::from_secs(200);

impl Browser {
    fn start(folder: &Path) -> Self {
        let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/cockpit/driver.mjs");
        let mut node = Command::new("node");
        let node = node.arg(script).arg(folder).stdin(Stdio::piped()).stdout(Stdio::piped());
        let mut node = node.spawn().unwrap();
        let (input, output) = (node.stdin.take().unwrap(), node.stdout.take().unwrap());
        let asked = Arc::<Mutex<HashMap<u64, SyncSender<Value>>>>::default();
        let waiting = asked.clone();
        thread::spawn(move || {
            for line in BufReader::new(output).lines().map_while(Result::ok) {
                // The last line of one that is killed is cut.
                let Ok(answer) = serde_json::from_str::<Value>(&line) else { continue };
                let asker = answer["number"].as_u64().and_then(|number| waiting.lock().unwrap().remove(&number));
                asker.map(|asker| asker.send(answer));
            }
            // Nobody waits for a browser that has ended.
            waiting.lock().unwrap().clear();
            let _ = node.wait();
        });
        Self { input: Mutex::new(input), asked, next: AtomicU64::new(0) }
    }

    fn number(&self) -> u64 {
        self.next.fetch_add(1, Ordering::SeqCst)
    }

    /// What it answers; `None` where it does not.
    fn ask(&self, page: u64, mut asked: Value) -> Option<Value> {
        let number = self.number();
        (asked["number"], asked["page"]) = (number.into(), page.into());
        let (asker, answer) = mpsc::sync_channel(1);
        self.asked.lock().unwrap().insert(number, asker);
        writeln!(self.input.lock().unwrap(), "{asked}").ok()?;
        answer.recv_timeout(ANSWER_LIMIT).ok()
    }
}

/// A page, which knows nothing of the others.
pub(crate) struct Page {
    browser: &'static Browser,
    number: u64,
}

impl Page {
    /// Opens an address; `None` where there is no browser.
    pub(crate) fn open(url: &str) -> Option<Self> {
        let mut page = Self::start()?;
        page.goto(url, (1280, 720), "light", true);
        Some(page)
    }

    /// The same, which draws as often as a screen shows.
    pub(crate) fn open_at_full_rate(url: &str) -> Option<Self> {
        let mut page = Self::start()?;
        page.show(url, (1280, 720), "light", true, false);
        Some(page)
    }

    /// A page without an address yet.
    pub(crate) fn start() -> Option<Self> {
        seated();
        let browser = BROWSER.as_ref()?;
        Some(Self { browser, number: browser.number() })
    }

    /// Opens an address, whose page draws six times a second; the headers of the answer.
    pub(crate) fn goto(&mut self, url: &str, size: (u32, u32), scheme: &str, webgl: bool) -> Value {
        self.show(url, size, scheme, webgl, true)
    }

    fn show(&mut self, url: &str, (width, height): (u32, u32), scheme: &str, webgl: bool, seldom: bool) -> Value {
        let look = json!({ "width": width, "height": height, "scheme": scheme, "webgl": webgl, "seldom": seldom });
        self.ask(&json!({ "do": "open", "url": url, "look": look }))
    }

    pub(crate) fn eval(&mut self, code: &str) -> Value {
        self.ask(&json!({ "do": "eval", "code": code }))
    }

    pub(crate) fn number(&mut self, code: &str) -> f64 {
        let value = self.eval(code);
        value.as_f64().unwrap_or_else(|| panic!("{code} is {value}"))
    }

    pub(crate) fn text(&mut self, code: &str) -> String {
        let value = self.eval(code);
        value.as_str().unwrap_or_else(|| panic!("{code} is {value}")).to_owned()
    }

    pub(crate) fn until(&mut self, code: &str) {
        self.ask(&json!({ "do": "until", "code": code }));
    }

    pub(crate) fn key(&mut self, key: &str) {
        self.ask(&json!({ "do": "key", "key": key }));
    }

    pub(crate) fn click(&mut self, at: &str) {
        self.ask(&json!({ "do": "click", "at": at }));
    }

    /// Keeps a picture of the page for eyes, below the target folder.
    pub(crate) fn shot(&mut self, name: &str) {
        let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("cockpit-screens");
        std::fs::create_dir_all(&folder).unwrap();
        self.ask(&json!({ "do": "shot", "file": folder.join(name) }));
    }

    /// All that is seen was drawn after this was asked.
    pub(crate) fn drawn_anew(&mut self) {
        self.eval("globalThis.written.length = 0; plumb.looked_at = plumb.frames()");
        self.until("plumb.frames() > plumb.looked_at + 1");
    }

    /// Every text stands out from what is behind it by a contrast ratio of 4.5.
    pub(crate) fn assert_readable(&mut self, view: &str) {
        let seen = self.ask(&json!({ "do": "contrast" }));
        assert!(seen["looked"].as_u64().unwrap() > 20, "{view}: {seen}");
        assert_eq!(seen["found"], json!([]), "{view}: below a contrast ratio of 4.5");
    }

    /// A figure of Chromium's own about the page.
    pub(crate) fn metric(&mut self, name: &str) -> f64 {
        self.ask(&json!({ "do": "metrics" }))[name].as_f64().unwrap()
    }

    /// What was copied last, in whichever page.
    pub(crate) fn clipboard(&mut self) -> String {
        self.text("navigator.clipboard.readText()")
    }

    /// Bytes in use by the page's script after all that is not is gone.
    pub(crate) fn heap(&mut self) -> f64 {
        self.ask(&json!({ "do": "heap" })).as_f64().unwrap()
    }

    /// No error was said, and nobody else was asked for anything.
    pub(crate) fn assert_clean(&mut self) {
        assert_eq!(self.troubles(), Vec::<String>::new());
    }

    pub(crate) fn troubles(&mut self) -> Vec<String> {
        serde_json::from_value(self.ask(&json!({ "do": "troubles" }))).unwrap()
    }

    fn ask(&mut self, asked: &Value) -> Value {
        let mut answer = self.browser.ask(self.number, asked.clone()).expect("the browser answers");
        assert!(answer.get("error").is_none(), "{asked}: {answer}");
        answer["ok"].take()
    }
}

impl Drop for Page {
    fn drop(&mut self) {
        // A browser that has ended has closed it.
        let _ = self.browser.ask(self.number, json!({ "do": "close" }));
    }
}
