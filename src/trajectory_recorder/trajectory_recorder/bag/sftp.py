"""Bags on computers that are reached by SSH; importing it lets URLs of SFTP be read so.

The file system of `fsspec` takes any key of any host, waits for a silent server without end, and
does not tell the size of an open file; the path of `upath` does not say its host.
"""

import logging
from typing import Any

import paramiko
from fsspec import register_implementation
from fsspec.implementations.sftp import SFTPFileSystem
from upath.implementations.sftp import SFTPPath
from upath.registry import register_implementation as register_path

REQUEST = 2**16
"""Bytes asked for at once: a round trip each, and what OpenSSH sends in one answer."""

logging.getLogger("paramiko").setLevel(logging.CRITICAL)  # it tells of every cut connection itself


class SftpPath(SFTPPath):
    """A path on a host, which its text names: ``sftp://user@host:port/folder``."""

    __slots__ = ()

    def __str__(self) -> str:
        """Return the URL."""
        at = self.storage_options
        user = f"{at['username']}@" if at.get("username") else ""
        port = f":{at['port']}" if at.get("port") else ""
        return f"sftp://{user}{at.get('host', '')}{port}{self.path}"


class KnownHosts(SFTPFileSystem):
    """Files on hosts whose keys are in ``~/.ssh/known_hosts``.

    Keys and agent of the user log in; a connection that was cut is made anew.

    Parameters
    ----------
    host : str
        Name or address of the host.
    silence : float
        Time without an answer after which a request has failed [s].
    **options : object
        Further arguments of `paramiko.SSHClient.connect`: ``username``, ``port``, ...

    Raises
    ------
    PermissionError
        If the host's key is not the known one, or the host refuses the login.
    """

    def __init__(self, host: str, *, silence: float, **options: Any) -> None:
        self._silence = silence
        super().__init__(host, **options)

    def _connect(self) -> None:
        self.client = paramiko.SSHClient()
        self.client.load_system_host_keys()
        self.client.set_missing_host_key_policy(_Refused())
        waits = dict.fromkeys(
            ("timeout", "banner_timeout", "auth_timeout", "channel_timeout"), self._silence
        )
        try:
            self.client.connect(self.host, **waits | self.ssh_kwargs)
            self._session = self.client.open_sftp()
        except paramiko.BadHostKeyException as error:
            raise PermissionError(
                f"{self.host} has another key than in ~/.ssh/known_hosts: it is another computer, "
                "or was set up anew"
            ) from error
        except paramiko.AuthenticationException as error:
            raise PermissionError(f"{self.host} accepts no key of this user: {error}") from error
        self._session.get_channel().settimeout(self._silence)

    @property
    def ftp(self) -> Any:
        """The session; a new one where it was cut."""
        transport = self.client.get_transport()
        if transport is None or not transport.is_active():
            self._connect()
        return self._session

    def _open(self, path: str, mode: str = "rb", *_: Any, **__: Any) -> Any:
        file = self.ftp.open(path, mode)
        file.size = file.stat().st_size
        file.MAX_REQUEST_SIZE = REQUEST
        return file


class _Refused(paramiko.MissingHostKeyPolicy):
    def missing_host_key(self, client: Any, hostname: str, key: Any) -> None:  # noqa: ARG002
        raise PermissionError(
            f"{hostname} is not in ~/.ssh/known_hosts: connect to it once with ssh"
        )


for _protocol in ("sftp", "ssh"):
    register_implementation(_protocol, KnownHosts, clobber=True)
    register_path(_protocol, SftpPath, clobber=True)
