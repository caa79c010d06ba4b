"""The Robot API of PolyScope X (HTTP, port 80): what a dashboard is to older software.

`endpoints` has what each request does, on the controller's side of the mailbox; `server` takes requests from the port
and hands them over; `openapi` describes both in the document that clients look for first.
"""
