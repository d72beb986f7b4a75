//! Connections and their limits.
//!
//! HTTP/1.1 on the loopback: the page, the WebSocket `/socket`, of a recording its pictures, the figures of
//! `/metrics`, and the WebSocket `/foxglove`. A request has no body; whoever sends none in time,
//! and whoever comes when there are too many, is disconnected.

use std::{
    io,
    net::{SocketAddr, TcpListener},
    sync::Arc,
    thread,
    time::Duration,
};

use ::runtime::clock::monotonic_ns;
use axum::{
    Router,
    body::Body,
    extract::{Request, State, WebSocketUpgrade},
    http::{HeaderMap, StatusCode, Uri, header},
    middleware,
    response::{IntoResponse, Response},
    routing::get,
};
use hyper::server::conn::http1;
use hyper_util::{
    rt::{TokioIo, TokioTimer},
    service::TowerToHyperService,
};
use tokio::{
    runtime,
    sync::{OwnedSemaphorePermit, Semaphore},
};

use crate::{
    assets::Page,
    commands::{self, Commands},
    guard, metrics,
    recording::Recording,
    sight::{Look, Sight},
    socket,
    token::Token,
};

/// Connections at once.
pub const CONNECTIONS_MAX: usize = 96;
/// Viewers at once.
pub const VIEWERS_MAX: usize = 32;
/// Clients of the Foxglove WebSocket protocol at once.
#[cfg(feature = "foxglove")]
pub const CLIENTS_MAX: usize = 8;
/// The bytes of a viewer's command, or of a client's request, at most.
const MESSAGE_MAX: usize = 4096;
/// A request's headers, bytes.
const HEADERS_MAX: usize = 16 * 1024;
/// By then the headers of a request must have come.
const HEADERS_LIMIT: Duration = Duration::from_secs(10);
/// What the kernel holds for a viewer who does not read, bytes: a second's pictures.
const SEND_BUFFER: u32 = 64 * 1024;
/// Ports tried after the one that was asked for.
const PORTS: u16 = 100;
/// The pause after a connection that could not be taken, as when files are short.
const ACCEPT_PAUSE: Duration = Duration::from_millis(50);

/// Why the page cannot be served.
#[derive(Debug, thiserror::Error)]
pub enum ServerError {
    /// No port is free.
    #[error("serving the cockpit on {address} or one of the next {PORTS} ports: {cause}")]
    Listen {
        /// The first that was tried.
        address: SocketAddr,
        /// What the system said of the last.
        cause: io::Error,
    },
    /// The server cannot start.
    #[error("starting the cockpit's server: {0}")]
    Start(io::Error),
}

/// A server that listens and does not answer yet.
#[derive(Debug)]
pub struct Server {
    listener: TcpListener,
    address: SocketAddr,
}

/// What is served.
pub struct Site {
    /// What can be looked at.
    pub sight: Arc<dyn Sight>,
    /// What commands need; without it nobody gives any.
    pub token: Option<Token>,
    /// What is shown in the place of a system.
    pub recording: Option<Arc<Recording>>,
    /// Pages of others that `/foxglove` answers, by their origins.
    pub foxglove_origins: Vec<String>,
}

struct Served {
    page: Page,
    site: Site,
    room: Arc<Semaphore>,
    viewers: Arc<Semaphore>,
    #[cfg(feature = "foxglove")]
    clients: Arc<Semaphore>,
}

/// What is answered where nothing of the name is to be seen.
type NotThere = (StatusCode, String);

impl Served {
    /// Where the pictures come from of the vehicle that a request names, or of what is shown where it names none.
    fn look(&self, uri: &Uri) -> Result<Look, NotThere> {
        let vehicle = match uri.query().map(|query| query.split_once('=')) {
            None => Ok(None),
            Some(Some(("vehicle", name))) => Ok(Some(name)),
            Some(_) => Err(format!("expected {0} or {0}?vehicle=NAME", uri.path())),
        };
        let look = vehicle.and_then(|vehicle| self.site.sight.look(vehicle));
        look.map_err(|why| (StatusCode::NOT_FOUND, format!("{why}\n")))
    }
}

impl Server {
    /// Takes the port of `address`, or the next free one.
    pub fn bind(address: SocketAddr) -> Result<Self, ServerError> {
        let mut last = None;
        for port in address.port()..=address.port().saturating_add(PORTS) {
            match listen(SocketAddr::new(address.ip(), port)) {
                Ok(listener) => {
                    let address = listener.local_addr().map_err(ServerError::Start)?;
                    return Ok(Self { listener, address });
                }
                Err(cause) => last = Some(cause),
            }
        }
        let cause = last.unwrap_or_else(|| io::Error::from(io::ErrorKind::AddrInUse));
        Err(ServerError::Listen { address, cause })
    }

    /// What people open; with the token they can give commands there.
    pub fn address(&self, token: Option<&Token>) -> String {
        address(&format!("http://{}/", self.address), token)
    }

    /// Serves from a thread of its own, for as long as the process lives.
    pub fn start(self, site: Site) -> Result<(), ServerError> {
        let runtime = runtime::Builder::new_current_thread()
            .enable_all()
            .max_blocking_threads(commands::UNDER_WAY_MAX + 1)
            .build()
            .map_err(ServerError::Start)?;
        let listener = {
            let _inside = runtime.enter();
            tokio::net::TcpListener::from_std(self.listener).map_err(ServerError::Start)?
        };
        let foxglove_origins: Arc<[String]> = site.foxglove_origins.clone().into();
        let served = Arc::new(Served {
            page: Page::new(),
            room: Arc::new(Semaphore::new(commands::UNDER_WAY_MAX)),
            site,
            viewers: Arc::new(Semaphore::new(VIEWERS_MAX)),
            #[cfg(feature = "foxglove")]
            clients: Arc::new(Semaphore::new(CLIENTS_MAX)),
        });
        let router = Router::new()
            .route("/socket", get(connect))
            .route("/pictures", get(pictures))
            .route("/metrics", get(figures));
        #[cfg(feature = "foxglove")]
        let router = router.route(guard::FOXGLOVE, get(foxglove));
        let router = router
            .fallback(asset)
            .layer(middleware::from_fn_with_state(foxglove_origins, guard::guard))
            .with_state(served);
        let work = move || runtime.block_on(serve(listener, router));
        thread::Builder::new().name("cockpit-server".into()).spawn(work).map_err(ServerError::Start)?;
        Ok(())
    }
}

/// An address with what stands behind `#`.
pub fn address(base: &str, token: Option<&Token>) -> String {
    token.map_or_else(|| base.to_owned(), |token| format!("{base}#{}", token.text()))
}

/// Takes connections without end.
async fn serve(listener: tokio::net::TcpListener, router: Router) {
    let room = Arc::new(Semaphore::new(CONNECTIONS_MAX));
    loop {
        let Ok((stream, _)) = listener.accept().await else {
            tokio::time::sleep(ACCEPT_PAUSE).await;
            continue;
        };
        // Who comes beyond the limit is disconnected at once.
        let Ok(permit) = room.clone().try_acquire_owned() else { continue };
        let service = TowerToHyperService::new(router.clone());
        tokio::spawn(async move {
            let _permit: OwnedSemaphorePermit = permit;
            // Pictures are small and not to wait for each other.
            let _ = stream.set_nodelay(true);
            let mut http = http1::Builder::new();
            http.timer(TokioTimer::new()).header_read_timeout(HEADERS_LIMIT).max_buf_size(HEADERS_MAX);
            // A connection that fails is its client's matter.
            let _ = http.serve_connection(TokioIo::new(stream), service).with_upgrades().await;
        });
    }
}

async fn asset(State(served): State<Arc<Served>>, uri: Uri, headers: HeaderMap) -> Response {
    served.page.answer(uri.path(), &headers)
}

/// A viewer.
async fn connect(State(served): State<Arc<Served>>, uri: Uri, upgrade: WebSocketUpgrade) -> Response {
    let look = match served.look(&uri) {
        Ok(look) => look,
        Err(not_there) => return not_there.into_response(),
    };
    let Ok(permit) = served.viewers.clone().try_acquire_owned() else {
        return (StatusCode::SERVICE_UNAVAILABLE, "too many look already; close a page\n").into_response();
    };
    limited(upgrade).on_upgrade(async move |socket| {
        let _permit: OwnedSemaphorePermit = permit;
        let desk = look.desk.clone().filter(|desk| desk.takes_commands());
        let commands = desk.zip(served.site.token.clone());
        let commands = commands.map(|(desk, token)| Commands::new(desk, token, served.room.clone()));
        socket::serve(socket, &look.hub, commands.as_ref()).await;
    })
}

fn limited(upgrade: WebSocketUpgrade) -> WebSocketUpgrade {
    upgrade.max_message_size(MESSAGE_MAX).max_frame_size(MESSAGE_MAX).max_write_buffer_size(1 << 20)
}

/// A client of the Foxglove WebSocket protocol.
#[cfg(feature = "foxglove")]
async fn foxglove(State(served): State<Arc<Served>>, uri: Uri, upgrade: WebSocketUpgrade) -> Response {
    use crate::foxglove::{client, protocol};
    if served.site.recording.is_some() {
        return (StatusCode::NOT_FOUND, "this is a recording: open its file in the viewer\n").into_response();
    }
    let look = match served.look(&uri) {
        Ok(look) => look,
        Err(not_there) => return not_there.into_response(),
    };
    let upgrade = upgrade.protocols(protocol::NAMES);
    if upgrade.selected_protocol().is_none() {
        let expected = format!("expected the subprotocol {}\n", protocol::NAMES.join(" or "));
        return (StatusCode::BAD_REQUEST, expected).into_response();
    }
    let Ok(permit) = served.clients.clone().try_acquire_owned() else {
        return (StatusCode::SERVICE_UNAVAILABLE, "too many are connected already; close one\n").into_response();
    };
    limited(upgrade).on_upgrade(async move |socket| {
        let _permit: OwnedSemaphorePermit = permit;
        client::serve(socket, &look.system, &look.hub.live).await;
    })
}

async fn figures(State(served): State<Arc<Served>>, uri: Uri) -> Response {
    let look = match served.look(&uri) {
        Ok(look) => look,
        Err(not_there) => return not_there.into_response(),
    };
    let text = metrics::text(&look.system, &look.hub.newest(), monotonic_ns());
    ([(header::CONTENT_TYPE, metrics::CONTENT_TYPE)], text).into_response()
}

/// `/pictures?FROM+COUNT`: pictures of a recording.
async fn pictures(State(served): State<Arc<Served>>, request: Request) -> Response {
    let Some(recording) = &served.site.recording else {
        return (StatusCode::NOT_FOUND, "this is no recording\n").into_response();
    };
    let wanted = request.uri().query().and_then(|query| query.split_once('+'));
    let wanted = wanted.and_then(|(from, count)| Some((from.parse().ok()?, count.parse().ok()?)));
    let Some((from, count)) = wanted else {
        return (StatusCode::BAD_REQUEST, "expected /pictures?FROM+COUNT\n").into_response();
    };
    let kind = [(header::CONTENT_TYPE, "application/x-protobuf")];
    (kind, Body::from(recording.pictures(from, count))).into_response()
}

/// A socket whose connections hold little for whoever does not read.
fn listen(address: SocketAddr) -> io::Result<TcpListener> {
    use rustix::net::{AddressFamily, SocketFlags, SocketType, bind, listen, socket_with, sockopt};
    let family = if address.is_ipv4() { AddressFamily::INET } else { AddressFamily::INET6 };
    let flags = SocketFlags::CLOEXEC | SocketFlags::NONBLOCK;
    let socket = socket_with(family, SocketType::STREAM, flags, None)?;
    sockopt::set_socket_reuseaddr(&socket, true)?;
    sockopt::set_socket_send_buffer_size(&socket, SEND_BUFFER as usize)?;
    bind(&socket, &address)?;
    listen(&socket, 128)?;
    Ok(socket.into())
}
