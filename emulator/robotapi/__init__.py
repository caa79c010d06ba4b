"""The Robot API of PolyScope X (HTTP, port 80), the successor of the dashboard server.

`endpoints` implements each request, on the controller's side of the mailbox; `server` receives requests at the port
and hands them over; `openapi` describes both in the document that clients fetch first.
"""
