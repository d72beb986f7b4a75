//! Subscriptions to topics of a running system on this machine.
//!
//! Input: messages of the bus.
//!
//! Output: the messages as structured arrays.
//!
//! Time: the subscriber polls the bus and never waits for longer than its timeout.
//!
//! Failure: `ConnectionError` if the system is not running or has ended. If the subscriber is too
//! slow, the bus overwrites its oldest messages; the system never waits for it.
//!
//! Ports of the bus belong to one thread, but Python objects do not. The port therefore lives in a
//! worker thread, which polls only on request.

use std::{
    io,
    sync::{
        Mutex, PoisonError,
        mpsc::{Receiver, SyncSender, sync_channel},
    },
    thread::{self, JoinHandle},
    time::{Duration, Instant},
};

use bus::{BusError, Observer, SystemName, Tap};
use graph::Topic;
use mapping::names::UnknownName;
use messages::{AttitudeOutput, Layout};
use numpy::PyArrayDescr;
use plumbline_ahrs::Frame;
use pyo3::{
    exceptions::{PyConnectionError, PyRuntimeError, PyTimeoutError, PyValueError},
    prelude::*,
    types::{PyAny, PySlice, PyTuple},
};
use runtime::frames::attitude_to_frame;

use crate::{
    arguments,
    error::value_error,
    structured::{self, Field},
};

/// Name under which the ports of the subscribers are listed.
const PROCESS_NAME: &str = "python";
/// Time between two polls of the bus.
const POLL_INTERVAL: Duration = Duration::from_millis(5);
/// Longest time for which the worker polls on one request. Signals are handled between requests.
const REQUEST_DURATION: Duration = Duration::from_millis(50);
/// Longest timeout, s.
const MAX_TIMEOUT_S: f64 = 1e9;

/// Reply to a request.
enum Reply {
    /// Messages, oldest first; empty if there was none.
    Messages {
        /// Bits of all messages.
        words: Vec<u64>,
        /// `true` if older messages may have been overwritten.
        is_full: bool,
    },
    /// The system has ended, and all its messages were delivered.
    Ended,
}

/// Worker thread with the subscription. It ends when the requests end.
struct Worker {
    /// Longest wait of each request.
    requests: Option<SyncSender<Duration>>,
    replies: Mutex<Receiver<Result<Reply, BusError>>>,
    thread: Option<JoinHandle<()>>,
}

impl Worker {
    /// Starts the thread. Its first reply is that to the subscription.
    fn start(system: SystemName, topic: Topic, frame: Frame) -> io::Result<Self> {
        let (requests, received) = sync_channel(1);
        let (sender, replies) = sync_channel(1);
        let run = move || {
            let opened = Observer::attach(&system, PROCESS_NAME).and_then(|observer| {
                let tap = observer.tap(topic)?;
                Ok((observer, tap))
            });
            // A reply fails only if the subscriber was closed, which also ends the requests.
            match opened {
                Err(error) => {
                    let _ = sender.send(Err(error));
                }
                Ok((observer, tap)) => {
                    let _ = sender.send(Ok(Reply::Messages { words: Vec::new(), is_full: false }));
                    for wait in received {
                        let _ = sender.send(poll(&observer, &tap, topic, frame, wait));
                    }
                }
            }
        };
        let thread = thread::Builder::new().name("subscriber".into()).spawn(run)?;
        Ok(Self { requests: Some(requests), replies: Mutex::new(replies), thread: Some(thread) })
    }

    /// Waits for the next reply. The GIL must be released.
    fn reply(&mut self) -> PyResult<Reply> {
        match self.replies.get_mut().unwrap_or_else(PoisonError::into_inner).recv() {
            Ok(reply) => reply.map_err(exception),
            Err(_) => Err(PyRuntimeError::new_err("the thread of the subscriber has ended; create a new subscriber")),
        }
    }

    /// Requests messages and waits for them for at most `wait`. The GIL must be released.
    fn messages(&mut self, wait: Duration) -> PyResult<Reply> {
        // A request fails only if the thread has ended, which the missing reply shows.
        let _ = self.requests.as_ref().map(|requests| requests.send(wait));
        self.reply()
    }
}

impl Drop for Worker {
    fn drop(&mut self) {
        self.requests = None;
        // The thread is idle between requests, so it ends at once and frees its port.
        drop(self.thread.take().map(JoinHandle::join));
    }
}

/// Waits for messages for at most `wait`, or until the system ends.
fn poll(observer: &Observer, tap: &Tap, topic: Topic, frame: Frame, wait: Duration) -> Result<Reply, BusError> {
    let started = Instant::now();
    loop {
        // Checked first, so that the last messages of a system are delivered.
        let is_running = observer.is_running();
        let mut words = Vec::new();
        let is_full = tap.drain(&mut |bytes| {
            let attitude =
                (topic == Topic::Attitude).then(|| bytemuck::try_pod_read_unaligned::<AttitudeOutput>(bytes));
            let converted = attitude.and_then(Result::ok).map(|attitude| attitude_to_frame(frame, attitude));
            let bytes = converted.as_ref().map_or(bytes, bytemuck::bytes_of);
            words.extend(bytes.chunks_exact(size_of::<u64>()).map(bytemuck::pod_read_unaligned::<u64>));
        })?;
        if words.is_empty() && !is_running {
            return Ok(Reply::Ended);
        }
        if !words.is_empty() || started.elapsed() >= wait {
            return Ok(Reply::Messages { words, is_full });
        }
        thread::sleep(POLL_INTERVAL.min(wait));
    }
}

/// Subscription to a topic of a running system on this machine.
///
/// Iteration yields the messages, as elements of a structured array; it ends when the system ends.
/// `read` returns all buffered messages as one array. A system has room for a few observers, so
/// close the subscriber after use, or create it in a `with` statement.
///
/// system: name of the system, `name` in launch.toml.
/// topic: name of the topic, see `plumb topic list`.
/// frame: frame of the attitudes, see `Attitude`; other topics allow only "enu-rfu".
/// timeout_s: longest wait for a message, s; None waits as long as the system is running.
///
/// The fields of a message are those of `dtype`; `plumb topic info attitude` describes them. An
/// attitude has, among others, `t_end_ns` (time of its sample, ns), `quaternion` (4; w x y z),
/// `yaw_rad`, `pitch_rad`, `roll_rad`, `course_rad` (heading), `course_sd_rad`,
/// `inclination_sd_rad`, `rate_rad_s` (3) and `flags` (bits of `Flags`).
///
/// Raises ConnectionError if the system is not running, and ValueError if a name is unknown.
#[pyclass(module = "plumbline_ahrs")]
pub(crate) struct Subscriber {
    system: String,
    topic: Topic,
    dtype: Py<PyArrayDescr>,
    timeout_s: Option<f64>,
    worker: Option<Worker>,
    /// Messages for the iteration, and the index of the next one.
    pending: Option<(Py<PyAny>, usize)>,
    overflowed: bool,
}

#[pymethods]
impl Subscriber {
    #[new]
    #[pyo3(signature = (system = "plumbline", topic = "attitude", *, frame = "enu-rfu", timeout_s = None))]
    fn new(py: Python<'_>, system: &str, topic: &str, frame: &str, timeout_s: Option<f64>) -> PyResult<Self> {
        let unknown = || UnknownName::new("topic", topic, Topic::ALL.iter().map(|topic| topic.name()));
        let topic = Topic::from_name(topic).ok_or_else(|| value_error(unknown()))?;
        let frame = arguments::frame(frame)?;
        if frame != Frame::EnuRfu && topic != Topic::Attitude {
            return Err(value_error(format_args!(
                "messages of the topic {} have no other frame than enu-rfu",
                topic.name()
            )));
        }
        timeout_s.map(duration).transpose()?;
        let name = SystemName::new(system).map_err(value_error)?;
        let layout = messages::layout(topic);
        let dtype = structured::dtype(py, &fields(&layout), layout.size)?.unbind();
        let worker = py.detach(|| {
            let mut worker = Worker::start(name, topic, frame).map_err(PyErr::from)?;
            worker.reply().map(|_| worker)
        })?;
        let (system, worker) = (system.into(), Some(worker));
        Ok(Self { system, topic, dtype, timeout_s, worker, pending: None, overflowed: false })
    }

    /// Type of a message: names, types and offsets of its fields.
    #[getter]
    fn dtype(&self, py: Python<'_>) -> Py<PyArrayDescr> {
        self.dtype.clone_ref(py)
    }

    /// Name of the topic.
    #[getter]
    fn topic(&self) -> &'static str {
        self.topic.name()
    }

    /// True if messages may have been lost, because they were not read in time.
    #[getter]
    fn overflowed(&self) -> bool {
        self.overflowed
    }

    /// Return all messages since the last call, as a structured array, shape (n,), n ≥ 1.
    ///
    /// Waits for a message if there is none. Messages that were received for an iteration but not
    /// yet yielded are returned first.
    ///
    /// timeout_s: longest wait, s; by default that of the constructor.
    ///
    /// Raises TimeoutError if no message arrives in time, and ConnectionError if the system has
    /// ended.
    #[pyo3(signature = (timeout_s = None))]
    fn read<'py>(&mut self, py: Python<'py>, timeout_s: Option<f64>) -> PyResult<Bound<'py, PyAny>> {
        if let Some((array, next)) = self.pending.take() {
            return array.bind(py).get_item(PySlice::new(py, next as isize, isize::MAX, 1));
        }
        match self.receive(py, timeout_s.or(self.timeout_s))? {
            Some(messages) => Ok(messages),
            None => Err(PyConnectionError::new_err(format!("system {:?} has ended", self.system))),
        }
    }

    /// Leave the bus. The subscriber cannot be used afterwards.
    fn close(&mut self, py: Python<'_>) {
        let worker = self.worker.take();
        self.pending = None;
        py.detach(|| drop(worker));
    }

    fn __iter__(subscriber: PyRef<'_, Self>) -> PyRef<'_, Self> {
        subscriber
    }

    fn __next__<'py>(&mut self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyAny>>> {
        let (array, next) = match self.pending.take() {
            Some((array, next)) => (array.into_bound(py), next),
            None => match self.receive(py, self.timeout_s)? {
                Some(array) => (array, 0),
                None => return Ok(None),
            },
        };
        let message = array.get_item(next)?;
        if next + 1 < array.len()? {
            self.pending = Some((array.unbind(), next + 1));
        }
        Ok(Some(message))
    }

    fn __enter__(subscriber: PyRef<'_, Self>) -> PyRef<'_, Self> {
        subscriber
    }

    #[pyo3(signature = (*_exception))]
    fn __exit__(&mut self, py: Python<'_>, _exception: &Bound<'_, PyTuple>) {
        self.close(py);
    }

    fn __repr__(&self) -> String {
        format!("Subscriber({:?}, {:?})", self.system, self.topic.name())
    }
}

impl Subscriber {
    /// Waits for messages. Returns `None` if the system has ended.
    fn receive<'py>(&mut self, py: Python<'py>, timeout_s: Option<f64>) -> PyResult<Option<Bound<'py, PyAny>>> {
        let timeout = timeout_s.map(duration).transpose()?;
        let started = Instant::now();
        let closed = || PyValueError::new_err("the subscriber is closed; create a new one");
        let worker = self.worker.as_mut().ok_or_else(closed)?;
        loop {
            let left = timeout.map_or(REQUEST_DURATION, |timeout| timeout.saturating_sub(started.elapsed()));
            match py.detach(|| worker.messages(left.min(REQUEST_DURATION)))? {
                Reply::Ended => return Ok(None),
                Reply::Messages { words, is_full } => {
                    self.overflowed |= is_full;
                    if !words.is_empty() {
                        return structured::array(words, self.dtype.bind(py)).map(Some);
                    }
                }
            }
            py.check_signals()?;
            if let Some(timeout_s) = timeout_s.filter(|_| timeout.is_some_and(|timeout| started.elapsed() >= timeout)) {
                let (system, topic) = (&self.system, self.topic.name());
                return Err(PyTimeoutError::new_err(format!(
                    "no message of the topic {topic} within {timeout_s} s; check the system with `plumb doctor --system {system}`"
                )));
            }
        }
    }
}

/// Returns a timeout as a duration.
fn duration(timeout_s: f64) -> PyResult<Duration> {
    let is_valid = (0.0..=MAX_TIMEOUT_S).contains(&timeout_s);
    let invalid =
        || value_error(format_args!("timeout_s is {timeout_s}; choose 0 to {MAX_TIMEOUT_S}, or None to wait"));
    is_valid.then(|| Duration::from_secs_f64(timeout_s)).ok_or_else(invalid)
}

/// Returns an error of the bus as an exception.
fn exception(error: BusError) -> PyErr {
    PyConnectionError::new_err(error.to_string())
}

/// Returns the fields of a message. An enumeration is an integer, a text is bytes.
fn fields(layout: &Layout) -> Vec<Field> {
    let ends = layout.fields.iter().skip(1).map(|field| field.offset).chain([layout.size]);
    let field = |(field, end): (&messages::Field, usize)| {
        let (kind, size) = (field.kind, end - field.offset);
        let element = kind.strip_prefix('[').and_then(|kind| kind.split(';').next());
        let format = match (element, element.unwrap_or(kind)) {
            (Some(_), "u8") => format!("S{size}"),
            (Some(_), "u32") => format!("({},)u4", size / 4),
            (Some(_), "u64") => format!("({},)u8", size / 8),
            (Some(_), "f64") => format!("({},)f8", size / 8),
            (None, "f64") => "f8".into(),
            (None, "i64") => "i8".into(),
            _ => format!("u{size}"),
        };
        Field { name: field.name, format, offset: field.offset }
    };
    layout.fields.iter().zip(ends).map(field).collect()
}
