//! HTTP server of the cockpit, with its connection limits.
//!
//! Input: HTTP/1.1 requests without a body, plain on the loopback interface, otherwise over TLS.
//! Output: the page, the WebSocket `/socket`, the snapshots of a recording, `/metrics`, and the
//! WebSocket `/foxglove`. With TLS everything except the page's files requires a token.
//! Failure: clients that send no request in time and clients beyond the limits of `places` and
//! `inflow` are disconnected.

use std::{
    io,
    net::{SocketAddr, TcpListener},
    sync::Arc,
    thread,
    time::Duration,
};

use ::runtime::clock::monotonic_ns;
use axum::{
    Extension, Router,
    body::Body,
    extract::{
        Request, State, WebSocketUpgrade,
        ws::{WebSocket, close_code},
    },
    http::{HeaderMap, HeaderValue, StatusCode, Uri, header},
    middleware::{self, Next},
    response::{IntoResponse, Response},
    routing::get,
};
use hyper::{
    body::Incoming,
    server::conn::http1,
    service::{Service as _, service_fn},
};
use hyper_util::{
    rt::{TokioIo, TokioTimer},
    service::TowerToHyperService,
};
use launch::CockpitTls;
use tokio::{
    io::{AsyncRead, AsyncWrite},
    runtime,
    sync::Semaphore,
    time::timeout,
};
use tokio_rustls::TlsAcceptor;

use crate::{
    assets::PageFiles,
    authorization,
    commands::{self, Commands},
    inflow::{LimitedStream, MAX_MESSAGE_BYTES},
    metrics,
    origin_check::{self, AccessRules},
    places::{Place, Places, Use},
    recording::Recording,
    socket::{self, CLOSE_UNKNOWN_VEHICLE},
    tls::{self, TlsError},
    token::{Role, Token, Tokens},
    vehicles::{VehicleDirectory, VehicleView, ViewUse},
};

/// Time limit of the TLS handshake.
const HANDSHAKE_TIMEOUT: Duration = Duration::from_secs(10);
/// Maximum size of the headers of a request, in bytes.
const MAX_HEADER_BYTES: usize = 16 * 1024;
/// Time limit for receiving the headers of a request.
const HEADER_TIMEOUT: Duration = Duration::from_secs(10);
/// Size of the kernel's send buffer per connection, in bytes. It holds about a second of snapshots.
const SEND_BUFFER_BYTES: u32 = 64 * 1024;
/// Number of ports tried after the requested one.
const MAX_PORT_RETRIES: u16 = 100;
/// Delay after a failed accept, for example when file descriptors are exhausted.
const ACCEPT_RETRY_DELAY: Duration = Duration::from_millis(50);

/// Error that prevents the page from being served.
#[derive(Debug, thiserror::Error)]
pub enum ServerError {
    /// None of the ports tried can be used.
    #[error("cannot serve the cockpit on {address} or one of the next {MAX_PORT_RETRIES} ports: {cause}")]
    Listen {
        /// First address tried.
        address: SocketAddr,
        /// Error for the last address tried.
        cause: io::Error,
    },
    /// The TLS configuration is invalid.
    #[error(transparent)]
    Tls(#[from] TlsError),
    /// The server's runtime, socket or thread cannot be created.
    #[error("cannot start the cockpit's server: {0}")]
    Start(io::Error),
}

/// Server that is bound to its port but does not accept connections yet.
pub struct Server {
    listener: TcpListener,
    address: SocketAddr,
    tls: Option<TlsAcceptor>,
}

/// Content of the site, with the tokens and origins that are granted access.
pub struct SiteContent {
    /// Vehicles that can be shown.
    pub vehicles: Arc<dyn VehicleDirectory>,
    /// Tokens required for commands and, with TLS, for viewing. If `None`, commands are rejected,
    /// and so is viewing with TLS.
    pub tokens: Option<Tokens>,
    /// Recording to show instead of a system.
    pub recording: Option<Arc<Recording>>,
    /// Origins of other pages that may use `/foxglove`.
    pub foxglove_origins: Vec<String>,
}

struct ServerState {
    page: PageFiles,
    site: SiteContent,
    /// `true` if connections use TLS. Viewing then requires a token.
    uses_tls: bool,
    command_permits: Arc<Semaphore>,
}

/// Status and message for an unknown vehicle or an invalid query.
type NotFound = (StatusCode, String);

impl ServerState {
    /// Returns the role granted by the token of a request.
    fn role(&self, headers: &HeaderMap) -> Option<Role> {
        authorization::role(headers, self.site.tokens.as_ref())
    }

    /// Returns the response to a request that lacks a required token. Returns `None` if the request
    /// is authorised.
    fn authorization_error(&self, headers: &HeaderMap) -> Option<Response> {
        (self.uses_tls && self.role(headers).is_none()).then(authorization::unauthorized)
    }

    /// Returns the view of the vehicle named in the query, or the default view if none is named.
    fn view(&self, uri: &Uri, view_use: ViewUse) -> Result<VehicleView, NotFound> {
        let vehicle = match uri.query().map(|query| query.split_once('=')) {
            None => Ok(None),
            Some(Some(("vehicle", name))) => Ok(Some(name)),
            Some(_) => Err(format!("expected {0} or {0}?vehicle=NAME", uri.path())),
        };
        let view = vehicle.and_then(|vehicle| self.site.vehicles.view(vehicle, view_use));
        view.map_err(|reason| (StatusCode::NOT_FOUND, format!("{reason}\n")))
    }
}

impl Server {
    /// Binds to `address`, or to the next free port if its port is in use. If `tls` is given, the
    /// server uses TLS.
    ///
    /// # Errors
    ///
    /// Returns an error if the certificate cannot be used or none of the ports is free.
    pub fn bind(address: SocketAddr, tls: Option<&CockpitTls>) -> Result<Self, ServerError> {
        let tls = tls.map(tls::acceptor).transpose()?;
        let mut last = None;
        for port in address.port()..=address.port().saturating_add(MAX_PORT_RETRIES) {
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

    /// Returns the URL of the page. If a token is given, the URL contains it and grants its role.
    pub fn address(&self, token: Option<&Token>) -> String {
        let scheme = if self.tls.is_some() { "https" } else { "http" };
        let base = match self.address.ip().is_unspecified() {
            true => format!("{scheme}://{}:{}/", host_name(), self.address.port()),
            false => format!("{scheme}://{}/", self.address),
        };
        address(&base, token)
    }

    /// Serves the content in a separate thread for the lifetime of the process.
    ///
    /// # Errors
    ///
    /// Returns an error if the runtime or the thread cannot be created.
    pub fn start(self, site: SiteContent) -> Result<(), ServerError> {
        let runtime = runtime::Builder::new_current_thread()
            .enable_all()
            .max_blocking_threads(commands::MAX_CONCURRENT_COMMANDS + 1)
            .build()
            .map_err(ServerError::Start)?;
        let listener = {
            let _guard = runtime.enter();
            tokio::net::TcpListener::from_std(self.listener).map_err(ServerError::Start)?
        };
        let uses_tls = self.tls.is_some();
        let rules = Arc::new(AccessRules { foxglove_origins: site.foxglove_origins.clone(), uses_tls });
        let state = Arc::new(ServerState {
            page: PageFiles::new(),
            command_permits: Arc::new(Semaphore::new(commands::MAX_CONCURRENT_COMMANDS)),
            site,
            uses_tls,
        });
        let router = Router::new()
            .route("/socket", get(view_socket))
            .route("/snapshots", get(recording_snapshots))
            .route("/metrics", get(metrics_page));
        #[cfg(feature = "foxglove")]
        let router = router.route(origin_check::FOXGLOVE_PATH, get(foxglove_socket));
        let router = router
            .fallback(asset)
            .layer(middleware::from_fn_with_state(state.clone(), take_place))
            .layer(middleware::from_fn_with_state(rules, origin_check::check_origin))
            .with_state(state);
        let tls = self.tls;
        let run = move || runtime.block_on(serve(listener, tls, router));
        thread::Builder::new().name("cockpit-server".into()).spawn(run).map_err(ServerError::Start)?;
        Ok(())
    }
}

/// Returns the URL of the page, with the token, if any, as its fragment.
pub fn address(base: &str, token: Option<&Token>) -> String {
    token.map_or_else(|| base.to_owned(), |token| format!("{base}#{}", token.text()))
}

/// Accepts connections forever.
async fn serve(listener: tokio::net::TcpListener, tls: Option<TlsAcceptor>, router: Router) {
    let places = Arc::<Places>::default();
    loop {
        let Ok((stream, address)) = listener.accept().await else {
            tokio::time::sleep(ACCEPT_RETRY_DELAY).await;
            continue;
        };
        let place = places.admit(address.ip());
        let (router, tls) = (router.clone(), tls.clone());
        tokio::spawn(async move {
            // Nagle's algorithm is disabled, because it would delay the small snapshots.
            let _ = stream.set_nodelay(true);
            let serve = async {
                match tls {
                    None => serve_connection(stream, router, place.clone()).await,
                    Some(tls) => {
                        if let Ok(Ok(stream)) = timeout(HANDSHAKE_TIMEOUT, tls.accept(stream)).await {
                            serve_connection(stream, router, place.clone()).await;
                        }
                    }
                }
            };
            place.hold(serve).await;
        });
        // Requests that have already arrived are received first, before further connections can
        // displace their clients.
        tokio::task::yield_now().await;
    }
}

/// Serves the requests of a connection.
async fn serve_connection(stream: impl AsyncRead + AsyncWrite + Unpin + Send + 'static, router: Router, place: Place) {
    let stream = LimitedStream::new(stream, place.inflow().clone());
    let router = TowerToHyperService::new(router);
    let service = service_fn(move |mut request: hyper::Request<Incoming>| {
        request.extensions_mut().insert(place.clone());
        router.call(request)
    });
    let mut http = http1::Builder::new();
    http.timer(TokioTimer::new()).header_read_timeout(HEADER_TIMEOUT).max_buf_size(MAX_HEADER_BYTES);
    // An error concerns only this client, so it is ignored.
    let _ = http.serve_connection(TokioIo::new(stream), service).with_upgrades().await;
}

/// Moves a connection to the class of clients with a token if the request has a valid one. Closes
/// other connections after a few requests.
async fn take_place(
    State(state): State<Arc<ServerState>>,
    Extension(place): Extension<Place>,
    request: Request,
    next: Next,
) -> Response {
    let shown = state.role(request.headers()).map_or(Ok(()), |role| place.show_token(role));
    let may_continue = shown.is_ok() && place.count_request();
    let mut response = match shown {
        Ok(()) => next.run(request).await,
        Err(full) => (StatusCode::SERVICE_UNAVAILABLE, format!("{full}\n")).into_response(),
    };
    if !may_continue && response.status() != StatusCode::SWITCHING_PROTOCOLS {
        response.headers_mut().insert(header::CONNECTION, HeaderValue::from_static("close"));
    }
    response
}

/// Returns the host name under which other machines reach this one.
fn host_name() -> String {
    rustix::system::uname().nodename().to_string_lossy().into_owned()
}

async fn asset(State(state): State<Arc<ServerState>>, uri: Uri, headers: HeaderMap) -> Response {
    state.page.respond(uri.path(), &headers)
}

/// Upgrades a viewer's connection to a WebSocket.
async fn view_socket(
    State(state): State<Arc<ServerState>>,
    Extension(place): Extension<Place>,
    uri: Uri,
    upgrade: WebSocketUpgrade,
) -> Response {
    if let Err(full) = place.change_use(Use::Viewer) {
        return (StatusCode::SERVICE_UNAVAILABLE, format!("{full}\n")).into_response();
    }
    place.inflow().start_messages();
    with_limits(upgrade).on_upgrade(async move |socket| place.hold(serve_viewer(socket, &state, &uri, &place)).await)
}

/// Serves a viewer until it disconnects.
async fn serve_viewer(mut socket: WebSocket, state: &ServerState, uri: &Uri, place: &Place) {
    let tokens = state.site.tokens.as_ref();
    // A view is opened only for a client that may see it.
    if state.uses_tls
        && let Err(rejection) = authorization::receive_token(&mut socket, tokens, place).await
    {
        return socket::close(socket, close_code::POLICY, &rejection.to_string()).await;
    }
    let open_view = || state.view(uri, ViewUse::of_viewer(place.role()));
    let mut view = open_view();
    // If all views for clients without a token are in use, a page with a token can still get a
    // view, because it sends the token in its first message.
    if view.is_err() && place.role().is_none() && authorization::receive_token(&mut socket, tokens, place).await.is_ok()
    {
        view = open_view();
    }
    let view = match view {
        Ok(view) => view,
        Err((_, reason)) => return socket::close(socket, CLOSE_UNKNOWN_VEHICLE, reason.trim_end()).await,
    };
    let target = view.target.clone().filter(|target| target.accepts_commands());
    let commands = target.zip(state.site.tokens.clone());
    let commands = commands.map(|(target, tokens)| Commands::new(target, tokens, state.command_permits.clone()));
    socket::serve(socket, view.hub, commands.as_ref(), tokens, place).await;
}

fn with_limits(upgrade: WebSocketUpgrade) -> WebSocketUpgrade {
    upgrade.max_message_size(MAX_MESSAGE_BYTES).max_frame_size(MAX_MESSAGE_BYTES).max_write_buffer_size(1 << 20)
}

/// Upgrades the connection of a Foxglove client to a WebSocket.
#[cfg(feature = "foxglove")]
async fn foxglove_socket(
    State(state): State<Arc<ServerState>>,
    Extension(place): Extension<Place>,
    uri: Uri,
    headers: HeaderMap,
    upgrade: WebSocketUpgrade,
) -> Response {
    use crate::foxglove::{client, protocol};
    if let Some(rejection) = state.authorization_error(&headers) {
        return rejection;
    }
    if state.site.recording.is_some() {
        return (
            StatusCode::NOT_FOUND,
            "/foxglove serves live systems only; open the recording's file in the viewer\n",
        )
            .into_response();
    }
    let view = match state.view(&uri, ViewUse::of_viewer(place.role())) {
        Ok(view) => view,
        Err(not_found) => return not_found.into_response(),
    };
    let upgrade = upgrade.protocols(protocol::SUBPROTOCOLS);
    if upgrade.selected_protocol().is_none() {
        let expected = format!("expected the subprotocol {}\n", protocol::SUBPROTOCOLS.join(" or "));
        return (StatusCode::BAD_REQUEST, expected).into_response();
    }
    if let Err(full) = place.change_use(Use::Foxglove) {
        return (StatusCode::SERVICE_UNAVAILABLE, format!("{full}\n")).into_response();
    }
    place.inflow().start_messages();
    with_limits(upgrade).on_upgrade(async move |socket| {
        place.hold(client::serve(socket, &view.system, &view.hub.broadcaster, place.inflow())).await;
    })
}

async fn metrics_page(State(state): State<Arc<ServerState>>, uri: Uri, headers: HeaderMap) -> Response {
    if let Some(rejection) = state.authorization_error(&headers) {
        return rejection;
    }
    let view = match state.view(&uri, ViewUse::Metrics) {
        Ok(view) => view,
        Err(not_found) => return not_found.into_response(),
    };
    let text = metrics::render(&view.system, &view.hub.latest(), monotonic_ns());
    ([(header::CONTENT_TYPE, metrics::CONTENT_TYPE)], text).into_response()
}

/// Serves `/snapshots?FROM+COUNT`, which returns snapshots of a recording.
async fn recording_snapshots(State(state): State<Arc<ServerState>>, request: Request) -> Response {
    if let Some(rejection) = state.authorization_error(request.headers()) {
        return rejection;
    }
    let Some(recording) = &state.site.recording else {
        return (StatusCode::NOT_FOUND, "this server shows no recording\n").into_response();
    };
    let range = request.uri().query().and_then(|query| query.split_once('+'));
    let range = range.and_then(|(from, count)| Some((from.parse().ok()?, count.parse().ok()?)));
    let Some((from, count)) = range else {
        return (StatusCode::BAD_REQUEST, "expected /snapshots?FROM+COUNT\n").into_response();
    };
    let kind = [(header::CONTENT_TYPE, "application/x-protobuf")];
    (kind, Body::from(recording.encode_snapshots(from, count))).into_response()
}

/// Opens a listening socket with a small send buffer. A slow client therefore loses messages
/// instead of falling behind.
fn listen(address: SocketAddr) -> io::Result<TcpListener> {
    use rustix::net::{AddressFamily, SocketFlags, SocketType, bind, listen, socket_with, sockopt};
    let family = if address.is_ipv4() { AddressFamily::INET } else { AddressFamily::INET6 };
    let flags = SocketFlags::CLOEXEC | SocketFlags::NONBLOCK;
    let socket = socket_with(family, SocketType::STREAM, flags, None)?;
    sockopt::set_socket_reuseaddr(&socket, true)?;
    sockopt::set_socket_send_buffer_size(&socket, SEND_BUFFER_BYTES as usize)?;
    bind(&socket, &address)?;
    listen(&socket, 128)?;
    Ok(socket.into())
}
