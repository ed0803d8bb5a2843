"""Request of the verb ``tracker-bridge``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Self

from pydantic import Field, model_validator

from cellapp.commands.fields import ProfilePath
from cellapp.commands.record import Asked, Request, Verb


class TrackerBridgeRequest(Request):
    """Serve the tracker that this computer is wired to, to the cell PC, until interrupted."""

    profile: ProfilePath
    host: Annotated[str, Asked("Address to listen on; one that other machines reach needs a token.")] = "127.0.0.1"
    port: Annotated[int | None, Field(ge=0, le=65535), Asked("TCP port; else 50960, or none beside --serial.")] = None
    serial: Annotated[str | None, Asked("A serial port to serve, as COM3 or /dev/ttyUSB0.", "PORT")] = None
    baud: Annotated[int, Field(ge=300), Asked("Of the serial port.")] = 115200
    token_file: Annotated[Path | None, Asked("The shared token; only you may read the file.", "FILE")] = None
    token_env: Annotated[str | None, Asked("Environment variable that holds the token.", "NAME")] = None

    @model_validator(mode="after")
    def _one_token(self) -> Self:
        """Refuse two sources of the token."""
        if self.token_file is not None and self.token_env is not None:
            raise ValueError("give --token-file or --token-env, not both")
        return self


VERB = Verb("tracker-bridge", TrackerBridgeRequest, chapter="cell")
