"""An SSH server for the files of a folder, which fails as it is told to."""

import os
import socket
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any, Self

import paramiko


class SftpServer:
    """Serves a folder on a port of its own while its block runs; knows one user's key.

    Parameters
    ----------
    folder : Path
        Its root.
    user_key : paramiko.PKey
        Of the user who may log in.
    fault : callable, optional
        Gets the connection and the bytes of a read, and may cut it or wait.
    """

    def __init__(
        self,
        folder: Path,
        user_key: paramiko.PKey,
        fault: Callable[[paramiko.Transport, bytes], None] = lambda transport, data: None,
    ) -> None:
        self.key, self.sent, self.connections = paramiko.ECDSAKey.generate(), 0, 0
        self._folder, self._user_key, self._fault = folder, user_key, fault
        self._socket = socket.create_server(("127.0.0.1", 0))
        self.port = self._socket.getsockname()[1]
        self._transports: list[paramiko.Transport] = []
        self._thread = threading.Thread(target=self._serve)

    @property
    def url(self) -> str:
        """Of its root."""
        return f"sftp://somebody@127.0.0.1:{self.port}"

    @property
    def known_host(self) -> str:
        """Its line in known_hosts."""
        return f"[127.0.0.1]:{self.port} {self.key.get_name()} {self.key.get_base64()}\n"

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._socket.shutdown(socket.SHUT_RDWR)
        self._thread.join()
        self._socket.close()
        for transport in self._transports:
            transport.close()

    def _serve(self) -> None:
        while True:
            try:
                connection, _ = self._socket.accept()
            except OSError:  # the block has ended
                return
            self.connections += 1
            transport = paramiko.Transport(connection)
            self._transports.append(transport)
            transport.add_server_key(self.key)
            transport.set_subsystem_handler("sftp", paramiko.SFTPServer, _Files, self, transport)
            transport.start_server(event=threading.Event(), server=_Login(self._user_key))

    def read(self, transport: paramiko.Transport, data: bytes) -> bytes:
        """Bytes that are sent."""
        self._fault(transport, data)
        self.sent += len(data)
        return data

    def place(self, path: str) -> Path:
        """Where a file of the root is."""
        return self._folder / path.lstrip("/")


class _Login(paramiko.ServerInterface):
    def __init__(self, user_key: paramiko.PKey) -> None:
        self._user_key = user_key

    def check_auth_publickey(self, username: str, key: paramiko.PKey) -> int:
        known = username == "somebody" and key == self._user_key
        return paramiko.AUTH_SUCCESSFUL if known else paramiko.AUTH_FAILED

    def get_allowed_auths(self, username: str) -> str:
        return "publickey"

    def check_channel_request(self, kind: str, chanid: int) -> int:
        return paramiko.OPEN_SUCCEEDED


class _Files(paramiko.SFTPServerInterface):
    def __init__(
        self, login: _Login, server: SftpServer, transport: paramiko.Transport, *_: Any
    ) -> None:
        super().__init__(login)
        self._server, self._transport = server, transport

    def stat(self, path: str) -> Any:
        try:
            return paramiko.SFTPAttributes.from_stat(self._server.place(path).stat())
        except OSError as error:
            return paramiko.SFTPServer.convert_errno(error.errno)

    def list_folder(self, path: str) -> Any:
        try:
            entries = sorted(self._server.place(path).iterdir())
        except OSError as error:
            return paramiko.SFTPServer.convert_errno(error.errno)
        return [paramiko.SFTPAttributes.from_stat(e.stat(), e.name) for e in entries]

    def open(self, path: str, flags: int, attr: Any) -> Any:
        try:
            file = self._server.place(path).open("rb")
        except OSError as error:
            return paramiko.SFTPServer.convert_errno(error.errno)
        return _Handle(file, self._server, self._transport, flags)


class _Handle(paramiko.SFTPHandle):
    def __init__(
        self, file: Any, server: SftpServer, transport: paramiko.Transport, flags: int
    ) -> None:
        super().__init__(flags)
        self._file, self._server, self._transport = file, server, transport

    def read(self, offset: int, length: int) -> bytes:
        return self._server.read(self._transport, os.pread(self._file.fileno(), length, offset))

    def stat(self) -> Any:
        return paramiko.SFTPAttributes.from_stat(os.fstat(self._file.fileno()))

    def close(self) -> None:
        self._file.close()
