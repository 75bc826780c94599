"""A typed client of revisit, visual place recognition over HTTP.

    from revisit_client import Revisit

    with Revisit("http://127.0.0.1:8000") as revisit:
        revisit.enroll("entrance.jpg", map="campus", place="entrance", x=12.0, y=3.5)
        answer = revisit.query("today.jpg", map="campus")
        if answer.status == "matched":
            print(answer.matches[0].view.place, answer.confidence)

Answers are the models of `revisit_client.wire`, which is the service's own module. Every exception that a call raises
about the service is a `ClientError`.
"""

from revisit_client import wire
from revisit_client.client import Revisit
from revisit_client.errors import ClientError, JobFailed, RevisitProblem, Unreachable, Unsendable
from revisit_client.parameters import zoom_between

__all__ = ["ClientError", "JobFailed", "Revisit", "RevisitProblem", "Unreachable", "Unsendable", "wire", "zoom_between"]
