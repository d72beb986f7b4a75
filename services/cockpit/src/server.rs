//! Connections and their limits.
//!
//! HTTP/1.1, on the loopback plain, beyond it in TLS, where nothing but the page itself is given without a token: the page, the WebSocket
//! `/socket`, of a recording its pictures, the figures of `/metrics`, and the WebSocket `/foxglove`. A request has no body; whoever sends none
//! in time, and whoever comes when there are too many, is disconnected.

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
use launch::CockpitTls;
use tokio::{
    io::{AsyncRead, AsyncWrite},
    runtime,
    sync::{OwnedSemaphorePermit, Semaphore},
    time::timeout,
};
use tokio_rustls::TlsAcceptor;

use crate::{
    assets::PageFiles,
    commands::{self, Commands},
    guard::{self, AccessRules},
    metrics,
    recording::Recording,
    sight::{Look, Sight},
    socket,
    tls::{self, TlsError},
    token::{Token, Tokens},
};

/// Connections at once.
pub const MAX_CONNECTIONS: usize = 96;
/// Viewers at once.
pub const MAX_VIEWERS: usize = 32;
/// Clients of the Foxglove WebSocket protocol at once.
#[cfg(feature = "foxglove")]
pub const MAX_CLIENTS: usize = 8;
/// The bytes of a viewer's command, or of a client's request, at most.
const MAX_MESSAGE: usize = 4096;
/// By then a connection speaks TLS.
const HANDSHAKE_LIMIT: Duration = Duration::from_secs(10);
/// A request's headers, bytes.
const MAX_HEADERS: usize = 16 * 1024;
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
    /// It is to speak TLS and cannot.
    #[error(transparent)]
    Tls(#[from] TlsError),
    /// The server cannot start.
    #[error("starting the cockpit's server: {0}")]
    Start(io::Error),
}

/// A server that listens and does not answer yet.
pub struct Server {
    listener: TcpListener,
    address: SocketAddr,
    tls: Option<TlsAcceptor>,
}

/// What is served.
pub struct Site {
    /// What can be looked at.
    pub sight: Arc<dyn Sight>,
    /// What commands need, and with TLS looking, too; without them nobody may.
    pub tokens: Option<Tokens>,
    /// What is shown in the place of a system.
    pub recording: Option<Arc<Recording>>,
    /// Pages of others that `/foxglove` answers, by their origins.
    pub foxglove_origins: Vec<String>,
}

struct Served {
    page: PageFiles,
    site: Site,
    /// TLS is spoken, and looking needs a token.
    is_secured: bool,
    room: Arc<Semaphore>,
    viewers: Arc<Semaphore>,
    #[cfg(feature = "foxglove")]
    clients: Arc<Semaphore>,
}

/// What is answered where nothing of the name is to be seen.
type NotThere = (StatusCode, String);

impl Served {
    /// What is answered to whoever sends these headers and may not see what is not the page itself.
    fn refuses(&self, headers: &HeaderMap) -> Option<Response> {
        let shown = headers.get(header::AUTHORIZATION).and_then(|field| field.to_str().ok()?.strip_prefix("Bearer "));
        let role = shown.zip(self.site.tokens.as_ref()).and_then(|(shown, tokens)| tokens.role(shown));
        if !self.is_secured || role.is_some() {
            return None;
        }
        let how = [(header::WWW_AUTHENTICATE, "Bearer")];
        let why = "a viewer's token is needed: `Authorization: Bearer TOKEN`\n";
        Some((StatusCode::UNAUTHORIZED, how, why).into_response())
    }

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
    /// Takes the port of `address`, or the next free one; with a certificate, TLS is spoken there.
    pub fn bind(address: SocketAddr, tls: Option<&CockpitTls>) -> Result<Self, ServerError> {
        let tls = tls.map(tls::acceptor).transpose()?;
        let mut last = None;
        for port in address.port()..=address.port().saturating_add(PORTS) {
            match listen(SocketAddr::new(address.ip(), port)) {
                Ok(listener) => {
                    let address = listener.local_addr().map_err(ServerError::Start)?;
                    return Ok(Self { listener, address, tls });
                }
                Err(cause) => last = Some(cause),
            }
        }
        let cause = last.unwrap_or_else(|| io::Error::from(io::ErrorKind::AddrInUse));
        Err(ServerError::Listen { address, cause })
    }

    /// What people open; with a token they may do there what is its role's.
    pub fn address(&self, token: Option<&Token>) -> String {
        let scheme = if self.tls.is_some() { "https" } else { "http" };
        let at = self.address;
        let base = match at.ip().is_unspecified() {
            true => format!("{scheme}://{}:{}/", host_name(), at.port()),
            false => format!("{scheme}://{at}/"),
        };
        address(&base, token)
    }

    /// Serves from a thread of its own, for as long as the process lives.
    pub fn start(self, site: Site) -> Result<(), ServerError> {
        let runtime = runtime::Builder::new_current_thread()
            .enable_all()
            .max_blocking_threads(commands::MAX_CONCURRENT_COMMANDS + 1)
            .build()
            .map_err(ServerError::Start)?;
        let listener = {
            let _inside = runtime.enter();
            tokio::net::TcpListener::from_std(self.listener).map_err(ServerError::Start)?
        };
        let is_secured = self.tls.is_some();
        let rules = Arc::new(AccessRules { foxglove_origins: site.foxglove_origins.clone(), uses_tls: is_secured });
        let served = Arc::new(Served {
            page: PageFiles::new(),
            room: Arc::new(Semaphore::new(commands::MAX_CONCURRENT_COMMANDS)),
            site,
            is_secured,
            viewers: Arc::new(Semaphore::new(MAX_VIEWERS)),
            #[cfg(feature = "foxglove")]
            clients: Arc::new(Semaphore::new(MAX_CLIENTS)),
        });
        let router = Router::new()
            .route("/socket", get(connect))
            .route("/pictures", get(pictures))
            .route("/metrics", get(figures));
        #[cfg(feature = "foxglove")]
        let router = router.route(guard::FOXGLOVE_PATH, get(foxglove));
        let router =
            router.fallback(asset).layer(middleware::from_fn_with_state(rules, guard::guard)).with_state(served);
        let tls = self.tls;
        let work = move || runtime.block_on(serve(listener, tls, router));
        thread::Builder::new().name("cockpit-server".into()).spawn(work).map_err(ServerError::Start)?;
        Ok(())
    }
}

/// An address with what stands behind `#`.
pub fn address(base: &str, token: Option<&Token>) -> String {
    token.map_or_else(|| base.to_owned(), |token| format!("{base}#{}", token.text()))
}

/// Takes connections without end.
async fn serve(listener: tokio::net::TcpListener, tls: Option<TlsAcceptor>, router: Router) {
    let room = Arc::new(Semaphore::new(MAX_CONNECTIONS));
    loop {
        let Ok((stream, _)) = listener.accept().await else {
            tokio::time::sleep(ACCEPT_PAUSE).await;
            continue;
        };
        // Who comes beyond the limit is disconnected at once.
        let Ok(permit) = room.clone().try_acquire_owned() else { continue };
        let (router, tls) = (router.clone(), tls.clone());
        tokio::spawn(async move {
            let _permit: OwnedSemaphorePermit = permit;
            // Pictures are small and not to wait for each other.
            let _ = stream.set_nodelay(true);
            match tls {
                None => answer(stream, router).await,
                Some(tls) => {
                    if let Ok(Ok(stream)) = timeout(HANDSHAKE_LIMIT, tls.accept(stream)).await {
                        answer(stream, router).await;
                    }
                }
            }
        });
    }
}

/// Answers the requests of a connection.
async fn answer(stream: impl AsyncRead + AsyncWrite + Unpin + Send + 'static, router: Router) {
    let mut http = http1::Builder::new();
    http.timer(TokioTimer::new()).header_read_timeout(HEADERS_LIMIT).max_buf_size(MAX_HEADERS);
    // A connection that fails is its client's matter.
    let _ = http.serve_connection(TokioIo::new(stream), TowerToHyperService::new(router)).with_upgrades().await;
}

/// What other machines call this one.
fn host_name() -> String {
    rustix::system::uname().nodename().to_string_lossy().into_owned()
}

async fn asset(State(served): State<Arc<Served>>, uri: Uri, headers: HeaderMap) -> Response {
    served.page.respond(uri.path(), &headers)
}

/// A viewer.
async fn connect(State(served): State<Arc<Served>>, uri: Uri, upgrade: WebSocketUpgrade) -> Response {
    let look = served.look(&uri);
    let Ok(permit) = served.viewers.clone().try_acquire_owned() else {
        return (StatusCode::SERVICE_UNAVAILABLE, "too many look already; close a page\n").into_response();
    };
    limited(upgrade).on_upgrade(async move |socket| {
        let _permit: OwnedSemaphorePermit = permit;
        let look = match look {
            Ok(look) => look,
            Err((_, why)) => return socket::turn_away(socket, why.trim_end()).await,
        };
        let desk = look.desk.clone().filter(|desk| desk.takes_commands());
        let commands = desk.zip(served.site.tokens.clone());
        let commands = commands.map(|(desk, tokens)| Commands::new(desk, tokens, served.room.clone()));
        let door = served.is_secured.then_some(served.site.tokens.as_ref());
        socket::serve(socket, look.hub, commands.as_ref(), door).await;
    })
}

fn limited(upgrade: WebSocketUpgrade) -> WebSocketUpgrade {
    upgrade.max_message_size(MAX_MESSAGE).max_frame_size(MAX_MESSAGE).max_write_buffer_size(1 << 20)
}

/// A client of the Foxglove WebSocket protocol.
#[cfg(feature = "foxglove")]
async fn foxglove(
    State(served): State<Arc<Served>>,
    uri: Uri,
    headers: HeaderMap,
    upgrade: WebSocketUpgrade,
) -> Response {
    use crate::foxglove::{client, protocol};
    if let Some(refused) = served.refuses(&headers) {
        return refused;
    }
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
        client::serve(socket, &look.system, &look.hub.broadcaster).await;
    })
}

async fn figures(State(served): State<Arc<Served>>, uri: Uri, headers: HeaderMap) -> Response {
    if let Some(refused) = served.refuses(&headers) {
        return refused;
    }
    let look = match served.look(&uri) {
        Ok(look) => look,
        Err(not_there) => return not_there.into_response(),
    };
    let text = metrics::render(&look.system, &look.hub.latest(), monotonic_ns());
    ([(header::CONTENT_TYPE, metrics::CONTENT_TYPE)], text).into_response()
}

/// `/pictures?FROM+COUNT`: pictures of a recording.
async fn pictures(State(served): State<Arc<Served>>, request: Request) -> Response {
    if let Some(refused) = served.refuses(request.headers()) {
        return refused;
    }
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
