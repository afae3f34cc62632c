"""Approving what somebody else has proposed: the act is checked again, and carried out."""

from storage.recording.acts.proposing import check_approver, open_proposal
from storage.sql.catalog import catalog_anew
from storage.store import Store, only_one
from stream.events import ApprovedAct, CertificateIssued, ModelActivated
from stream.security.actor import Actor


def approve(store: Store, uid: str, by: Actor) -> ApprovedAct:
    """Carry out the open proposal with that uid, or a beginning of it; returns the document in the log.

    BadInput if `by` has not proved who it is, has proposed it, or if it cannot be carried out any more; NotFound if
    there is no such proposal.
    """
    with only_one(store.folder / "tmp" / "proposals.lock", "gyrofleet proposal"):
        proposal = open_proposal(store, uid)
        check_approver(proposal, by)
        act = proposal.act
        if isinstance(act, ModelActivated):
            from analytics.loop.model import model_use

            return model_use.carry_out(store, proposal, by)
        if isinstance(act, CertificateIssued):
            from analytics.certificate import issue

            with catalog_anew(store) as catalog:
                return issue.carry_out(catalog, proposal, by)
        from analytics.specifications import entering

        return entering.carry_out(store, proposal, by)
