//! Chromium, controlled through playwright-core. One instance serves all tests.

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

/// Folder with the npm packages, which are installed on first use. `None` if they are unavailable.
/// The cause is then printed.
pub(crate) static PACKAGES: LazyLock<Option<PathBuf>> = LazyLock::new(|| match packages() {
    Ok(folder) => Some(folder),
    Err(cause) => {
        eprintln!("skipped: no browser available: {cause}");
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

/// Number of tests that have pages open. It is limited to the number of processors, because pages
/// are rendered in software.
static BROWSER_SLOTS: (Mutex<usize>, Condvar) = (Mutex::new(0), Condvar::new());

/// Permission for one test to open pages. It is released when the test's thread ends.
struct BrowserSlot;

impl BrowserSlot {
    fn acquire() -> Self {
        let (used, freed) = &BROWSER_SLOTS;
        let limit = thread::available_parallelism().map_or(1, usize::from);
        *freed.wait_while(used.lock().unwrap(), |taken| *taken >= limit).unwrap() += 1;
        Self
    }
}

impl Drop for BrowserSlot {
    fn drop(&mut self) {
        let (used, freed) = &BROWSER_SLOTS;
        *used.lock().unwrap() -= 1;
        freed.notify_one();
    }
}

/// Waits until this test may open pages.
pub(crate) fn wait_for_browser_slot() {
    thread_local!(static SLOT: OnceCell<BrowserSlot> = const { OnceCell::new() });
    SLOT.with(|slot| _ = slot.get_or_init(BrowserSlot::acquire));
}

/// Runs a program to completion and returns its output. If the program fails, returns its output as
/// the error.
pub(crate) fn run(command: &mut Command) -> Result<String, String> {
    let output = command.stdin(Stdio::null()).output().map_err(|cause| format!("{command:?}: {cause}"))?;
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    if output.status.success() { Ok(text(&output.stdout)) } else { Err(text(&output.stdout) + &text(&output.stderr)) }
}

/// Browser shared by all tests, because starting one takes as long as running many tests.
struct Browser {
    input: Mutex<ChildStdin>,
    /// Channels for replies not yet received, by request number.
    pending: Arc<Mutex<HashMap<u64, SyncSender<Value>>>>,
    next: AtomicU64,
}

/// Shared browser, or `None` if it is unavailable. It exits when the tests end and thereby close
/// its standard input.
static BROWSER: LazyLock<Option<Browser>> = LazyLock::new(|| PACKAGES.as_deref().map(Browser::start));

/// Time limit for a reply. It is longer than the driver's own time limits.
const REPLY_TIMEOUT: Duration = Duration::from_secs(200);

impl Browser {
    fn start(folder: &Path) -> Self {
        let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/cockpit/driver.mjs");
        let mut node = Command::new("node");
        let node = node.arg(script).arg(folder).stdin(Stdio::piped()).stdout(Stdio::piped());
        let mut node = node.spawn().unwrap();
        let (input, output) = (node.stdin.take().unwrap(), node.stdout.take().unwrap());
        let pending_replies = Arc::<Mutex<HashMap<u64, SyncSender<Value>>>>::default();
        let reader_channels = pending_replies.clone();
        thread::spawn(move || {
            for line in BufReader::new(output).lines().map_while(Result::ok) {
                // The last line of a killed driver may be truncated.
                let Ok(reply) = serde_json::from_str::<Value>(&line) else { continue };
                let sender =
                    reply["number"].as_u64().and_then(|number| reader_channels.lock().unwrap().remove(&number));
                sender.map(|sender| sender.send(reply));
            }
            // Drops the channels, so that no test waits for a driver that has ended.
            reader_channels.lock().unwrap().clear();
            let _ = node.wait();
        });
        Self { input: Mutex::new(input), pending: pending_replies, next: AtomicU64::new(0) }
    }

    fn number(&self) -> u64 {
        self.next.fetch_add(1, Ordering::SeqCst)
    }

    /// Returns the reply to a request, or `None` if the driver does not reply in time.
    fn request(&self, page: u64, mut request: Value) -> Option<Value> {
        let number = self.number();
        (request["number"], request["page"]) = (number.into(), page.into());
        let (sender, reply) = mpsc::sync_channel(1);
        self.pending.lock().unwrap().insert(number, sender);
        writeln!(self.input.lock().unwrap(), "{request}").ok()?;
        reply.recv_timeout(REPLY_TIMEOUT).ok()
    }
}

/// Page with a separate browser context.
pub(crate) struct Page {
    browser: &'static Browser,
    number: u64,
}

impl Page {
    /// Opens a URL. Returns `None` if no browser is available.
    pub(crate) fn open(url: &str) -> Option<Self> {
        let mut page = Self::new()?;
        page.goto(url, (1280, 720), "light", true);
        Some(page)
    }

    /// Opens a URL at the full frame rate.
    pub(crate) fn open_at_full_rate(url: &str) -> Option<Self> {
        let mut page = Self::new()?;
        page.show(url, (1280, 720), "light", true, false, &[]);
        Some(page)
    }

    /// Opens a URL. The first request for each of the given files fails.
    pub(crate) fn open_with_lost_files(url: &str, files: &[&str]) -> Option<Self> {
        let mut page = Self::new()?;
        page.show(url, (1280, 720), "light", true, true, files);
        Some(page)
    }

    /// Creates a page without opening a URL.
    pub(crate) fn new() -> Option<Self> {
        wait_for_browser_slot();
        let browser = BROWSER.as_ref()?;
        Some(Self { browser, number: browser.number() })
    }

    /// Opens a URL in a page limited to about six frames per second, and returns the response
    /// headers.
    pub(crate) fn goto(&mut self, url: &str, size: (u32, u32), scheme: &str, webgl: bool) -> Value {
        self.show(url, size, scheme, webgl, true, &[])
    }

    fn show(
        &mut self,
        url: &str,
        (width, height): (u32, u32),
        scheme: &str,
        webgl: bool,
        low_rate: bool,
        lost_files: &[&str],
    ) -> Value {
        let options = json!({ "width": width, "height": height, "scheme": scheme, "webgl": webgl, "low_rate": low_rate, "lost_files": lost_files });
        self.request(&json!({ "do": "open", "url": url, "options": options }))
    }

    pub(crate) fn eval(&mut self, code: &str) -> Value {
        self.request(&json!({ "do": "eval", "code": code }))
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
        self.request(&json!({ "do": "until", "code": code }));
    }

    pub(crate) fn key(&mut self, key: &str) {
        self.request(&json!({ "do": "key", "key": key }));
    }

    pub(crate) fn click(&mut self, at: &str) {
        self.request(&json!({ "do": "click", "at": at }));
    }

    /// Loads the page again.
    pub(crate) fn reload(&mut self) {
        self.request(&json!({ "do": "reload" }));
    }

    /// Loads the page again in a browser that denies access to its storage.
    pub(crate) fn reload_without_storage(&mut self) {
        self.request(&json!({ "do": "reload", "denied": true }));
    }

    /// Saves a screenshot below the target folder, for visual inspection, and returns its path.
    pub(crate) fn shot(&mut self, name: &str) -> PathBuf {
        let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("cockpit-screens");
        std::fs::create_dir_all(&folder).unwrap();
        let file = folder.join(name);
        self.request(&json!({ "do": "shot", "file": file }));
        file
    }

    /// Waits until all content has been redrawn.
    pub(crate) fn wait_for_redraw(&mut self) {
        self.eval("globalThis.written.length = 0; plumb.frames_before = plumb.frames()");
        self.until("plumb.frames() > plumb.frames_before + 1");
    }

    /// Asserts that every text has a contrast ratio of at least 4.5 to its background.
    pub(crate) fn assert_readable(&mut self, view: &str) {
        let result = self.request(&json!({ "do": "contrast" }));
        assert!(result["checked"].as_u64().unwrap() > 20, "{view}: {result}");
        assert_eq!(result["found"], json!([]), "{view}: below a contrast ratio of 4.5");
    }

    /// Asserts that no text is cut off or covers another one.
    pub(crate) fn assert_laid_out(&mut self, view: &str) {
        self.wait_for_redraw();
        assert_eq!(self.request(&json!({ "do": "layout" })), json!([]), "{view}");
    }

    /// Returns one of Chromium's performance metrics for the page.
    pub(crate) fn metric(&mut self, name: &str) -> f64 {
        self.request(&json!({ "do": "metrics" }))[name].as_f64().unwrap()
    }

    /// Returns the text that was last copied, by any page.
    pub(crate) fn clipboard(&mut self) -> String {
        self.text("navigator.clipboard.readText()")
    }

    /// Returns the heap size of the page's scripts in bytes, measured after garbage collection.
    pub(crate) fn heap(&mut self) -> f64 {
        self.request(&json!({ "do": "heap" })).as_f64().unwrap()
    }

    /// Asserts that the page had no errors and sent no requests to other hosts.
    pub(crate) fn assert_clean(&mut self) {
        assert_eq!(self.errors(), Vec::<String>::new());
    }

    pub(crate) fn errors(&mut self) -> Vec<String> {
        serde_json::from_value(self.request(&json!({ "do": "errors" }))).unwrap()
    }

    fn request(&mut self, request: &Value) -> Value {
        let mut reply = self.browser.request(self.number, request.clone()).expect("the driver replies in time");
        assert!(reply.get("error").is_none(), "{request}: {reply}");
        reply["ok"].take()
    }
}

impl Drop for Page {
    fn drop(&mut self) {
        // If the browser has ended, the page is already closed.
        let _ = self.browser.request(self.number, json!({ "do": "close" }));
    }
}
