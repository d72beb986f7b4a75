//! Check of the token of a client.
//!
//! Input: the header of a request, or a message of the page.
//! Output: the role that the token grants. [`server`](crate::server) decides where a role is
//! required, [`commands`](crate::commands) which role a command requires.
//! Failure: clients without a valid token are rejected.

use std::time::Duration;

use axum::{
    extract::ws::{Message, WebSocket},
    http::{HeaderMap, StatusCode, header},
    response::{IntoResponse, Response},
};
use tokio::time::timeout;
use wire::{
    command::ControlMessage as _,
    v1::{PageCommand, page_command::Kind},
};

use crate::{
    places::{NoPlace, Place},
    token::{Role, Tokens},
};

/// Time limit for presenting a required token.
const TOKEN_TIMEOUT: Duration = Duration::from_secs(5);

/// Returns the role granted by the token of a request. Returns `None` if the request has no valid
/// token.
pub(crate) fn role(headers: &HeaderMap, tokens: Option<&Tokens>) -> Option<Role> {
    let token = headers.get(header::AUTHORIZATION)?.to_str().ok()?.strip_prefix("Bearer ")?;
    tokens?.role(token)
}

/// Returns the response to a request that lacks a required token.
pub(crate) fn unauthorized() -> Response {
    let scheme = [(header::WWW_AUTHENTICATE, "Bearer")];
    let message = "a viewer's or operator's token is required: `Authorization: Bearer TOKEN`\n";
    (StatusCode::UNAUTHORIZED, scheme, message).into_response()
}

/// Receives a token as the viewer's first message.
///
/// # Errors
///
/// Fails if the message does not arrive in time, contains no valid token, or all places of clients
/// with this token are taken.
pub(crate) async fn receive_token(
    socket: &mut WebSocket,
    tokens: Option<&Tokens>,
    place: &Place,
) -> Result<(), TokenRejection> {
    let Ok(Some(Ok(message))) = timeout(TOKEN_TIMEOUT, socket.recv()).await else {
        return Err(TokenRejection::Missing);
    };
    place.inflow().record(&message);
    let Message::Binary(bytes) = message else { return Err(TokenRejection::Missing) };
    let command = PageCommand::from_bytes(&bytes).ok().filter(|command| command.kind() == Kind::View);
    show_token(&command.ok_or(TokenRejection::Missing)?, tokens, place)
}

/// Moves a viewer to the class of clients with the token of a command.
///
/// # Errors
///
/// Fails if the token is not valid, or all places of clients with this token are taken.
pub(crate) fn show_token(command: &PageCommand, tokens: Option<&Tokens>, place: &Place) -> Result<(), TokenRejection> {
    let role = tokens.and_then(|tokens| tokens.role(&command.token));
    Ok(place.show_token(role.ok_or(TokenRejection::Missing)?)?)
}

/// Reason why a viewer is not served.
#[derive(Debug, thiserror::Error)]
pub(crate) enum TokenRejection {
    /// The first message contains no valid token.
    #[error("token missing or wrong")]
    Missing,
    /// All places for clients with a token of this role are taken.
    #[error(transparent)]
    NoPlace(#[from] NoPlace),
}
