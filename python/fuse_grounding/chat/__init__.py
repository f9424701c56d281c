"""Language models: one question, one reply that fits a schema, kept on disk (docs/language-models.md)."""

from fuse_grounding.chat.client import Answer, Chat, NoReply, opened
from fuse_grounding.chat.messages import Message

__all__ = ["Answer", "Chat", "Message", "NoReply", "opened"]
