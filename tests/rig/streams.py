"""A webcam on the network: MJPEG over HTTP, each frame a grey of its own, 25 a second."""

from __future__ import annotations

import threading
import time
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import cv2
import numpy as np


class MjpegServer:
    """Serves frames of 64 x 48; `sent_ns` keeps when each grey was last sent, by its number."""

    def __init__(self, frames=10_000):
        self.sent_ns = {}
        owner = self

        class Handler(BaseHTTPRequestHandler):
            def do_GET(self):
                self.send_response(200)
                self.send_header("Content-Type", "multipart/x-mixed-replace; boundary=frame")
                self.end_headers()
                for number in range(frames):
                    if not owner._send(self.wfile, number % 60):
                        return
                    time.sleep(0.04)

            def log_message(self, *_):
                pass

        self._server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self._server.daemon_threads = True
        self.address = f"http://127.0.0.1:{self._server.server_address[1]}/stream.mjpg"

    def _send(self, file, number):
        _, data = cv2.imencode(".jpg", np.full((48, 64, 3), 4 * number, np.uint8))
        self.sent_ns[number] = time.monotonic_ns()
        head = f"--frame\r\nContent-Type: image/jpeg\r\nContent-Length: {len(data)}\r\n\r\n"
        try:
            file.write(head.encode() + data.tobytes() + b"\r\n")
        except OSError:
            return False
        return True

    def __enter__(self):
        threading.Thread(target=self._server.serve_forever, daemon=True).start()
        return self

    def __exit__(self, *_):
        self._server.shutdown()
        self._server.server_close()
